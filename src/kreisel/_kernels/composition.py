"""Preintegrated motion onto the navigation state, and from there to the reference's own time."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array, Indices
from kreisel._kernels.blocks import place
from kreisel._kernels.cell import IntegratedMotion, Moments
from kreisel._kernels.compilation import kernel
from kreisel._kernels.increments import Increments
from kreisel._kernels.rotation import rotate, turn


@kernel
def cross(a: Array, b: Array, out: Array) -> None:
    """Write a x b for columns, (3, m)."""
    for s in range(a.shape[1]):
        x = a[1, s] * b[2, s] - a[2, s] * b[1, s]
        y = a[2, s] * b[0, s] - a[0, s] * b[2, s]
        z = a[0, s] * b[1, s] - a[1, s] * b[0, s]
        out[0, s] = x
        out[1, s] = y
        out[2, s] = z


@kernel
def multiply(a: Array, b: Array, out: Array) -> None:
    """Write the quaternion products a * b for columns, (4, m); out is neither of them."""
    for s in range(a.shape[1]):
        out[0, s] = a[0, s] * b[0, s] - a[1, s] * b[1, s] - a[2, s] * b[2, s] - a[3, s] * b[3, s]
        out[1, s] = a[0, s] * b[1, s] + a[1, s] * b[0, s] + a[2, s] * b[3, s] - a[3, s] * b[2, s]
        out[2, s] = a[0, s] * b[2, s] - a[1, s] * b[3, s] + a[2, s] * b[0, s] + a[3, s] * b[1, s]
        out[3, s] = a[0, s] * b[3, s] + a[1, s] * b[2, s] - a[2, s] * b[1, s] + a[3, s] * b[0, s]


@kernel
def gather(points: Array, columns: Indices, source: Indices, known: Array, out: Array) -> None:
    """Write rows `source` (e,) of `columns` (m,) of points (size, M) to out (e, m); known (e,) where source is -1."""
    for e in range(out.shape[0]):
        for s in range(out.shape[1]):
            out[e, s] = known[e] if source[e] < 0 else points[source[e], columns[s]]


@kernel
def environment(
    level: float,
    down: float,
    q_rn: Array,
    north: Array,
    vertical: Array,
    magnitude: Array,
    gravity: Array,
    earth_rate: Array,
) -> None:
    """Write gravity and Earth rate in r, (3, m).

    level, down: Earth rate that a unit of north (2, m) and of vertical (m,) stand for; q_rn (4, m), magnitude (m,).
    """
    for s in range(gravity.shape[1]):
        gravity[0, s] = 0.0
        gravity[1, s] = 0.0
        gravity[2, s] = magnitude[s]  # equation (6) of docs/explanation/model.md
        earth_rate[0, s] = level * north[0, s]  # equation (7)
        earth_rate[1, s] = level * north[1, s]
        earth_rate[2, s] = down * vertical[s]
    rotate(q_rn, gravity)
    rotate(q_rn, earth_rate)


@kernel
def compose(
    duration: float,
    which: Indices,
    increments: Increments,
    gravity: Array,
    earth_rate: Array,
    q: Array,
    v: Array,
    p: Array,
) -> None:
    """Carry attitude q (4, m), velocity v and position p (3, m), in place, over an interval: equation (9).

    which (m,): the column of the increments each state moves by; gravity and earth_rate (3, m).

    Solves equations (4) and (5), v' = C f + g - 2 Omega x v, with gravity g and Earth rate Omega constant in r. With E
    the turn of r during the interval and y the displacement seen from where r stood at its beginning,
    d^2 y / dt^2 = C_0 (Delta C f) + E^-1 g + Omega x (Omega x y); the last term is left out (below 6e-9 m/s^2 for
    displacements under one metre).
    """
    m = q.shape[1]
    T = duration
    w = np.empty((3, m))
    wg = np.empty((3, m))
    wwg = np.empty((3, m))
    y = np.empty((3, m))
    y_dot = np.empty((3, m))
    turned = np.empty((4, m))
    E = np.zeros((4, m))
    dq_own = np.empty((4, m))
    for s in range(m):
        j = which[s]
        for i in range(4):
            dq_own[i, s] = increments.dq[i, j]
        for i in range(3):
            y_dot[i, s] = increments.dv[i, j]
            y[i, s] = increments.dp[i, j]
        for i in range(3):
            w[i, s] = -earth_rate[i, s] * T
        E[0, s] = 1.0
    turn(E, w, 1.0)
    cross(earth_rate, gravity, wg)
    cross(earth_rate, wg, wwg)
    rotate(q, y_dot)
    rotate(q, y)
    for i in range(3):
        for s in range(m):
            y_dot[i, s] += v[i, s] + T * (gravity[i, s] + T / 2.0 * (wg[i, s] + T / 3.0 * wwg[i, s]))
            y[i, s] += T * (v[i, s] + T / 2.0 * (gravity[i, s] + T / 3.0 * (wg[i, s] + T / 4.0 * wwg[i, s])))
    cross(earth_rate, y, w)
    for i in range(3):
        for s in range(m):
            y_dot[i, s] -= w[i, s]
    place(y_dot, 0, 0, v)
    rotate(E, v)
    rotate(E, y)
    for i in range(3):
        for s in range(m):
            p[i, s] += y[i, s]
    multiply(E, q, turned)  # equation (9)
    multiply(turned, dq_own, q)


@kernel
def pose_at(
    moments: Moments, motion: IntegratedMotion, q: Array, v: Array, p: Array, q_out: Array, p_out: Array
) -> None:
    """Write attitude (4, m) and position (3, m) a moment after the last sample: equation (12).

    The moment is at most a sampling interval away.
    q (4, m), v and p (3, m): attitude, velocity and position at the last sample.
    """
    which, own, earth_rate, gravity = moments.which, moments.own, motion.earth_rate, motion.gravity
    omega, alpha, u_end, q_first = motion.omega, motion.alpha, motion.force, motion.q_first
    dt_before, dt_after = moments.before, moments.after
    m = q.shape[1]
    theta = np.empty((3, m))
    back = np.empty((4, m))
    slope = np.empty((3, m))
    accel = np.empty((3, m))
    coriolis = np.empty((3, m))
    begin = np.empty((4, m))
    earth = np.empty((3, m))
    moment = np.empty(m)
    span = dt_before + dt_after
    for s in range(m):
        moment[s] = moments.dt[own[s]]
        for i in range(4):
            begin[i, s] = q_first[i, own[s]]
        for i in range(3):
            earth[i, s] = earth_rate[i, own[s]]
        back[0, s] = q[0, s]
        for i in range(3):
            back[i + 1, s] = -q[i + 1, s]
    place(earth, 0, 0, theta)
    rotate(back, theta)
    for i in range(3):
        for s in range(m):
            j = which[s]
            theta[i, s] = (omega[i, j] - theta[i, s] + 0.5 * alpha[i, j] * moment[s]) * moment[s]
            before = (u_end[1, i, j] - u_end[0, i, j]) / dt_before
            after = (u_end[2, i, j] - u_end[1, i, j]) / dt_after
            slope[i, s] = (before * dt_after + after * dt_before) / span
            accel[i, s] = u_end[1, i, j]
    rotate(begin, slope)
    rotate(begin, accel)
    cross(earth, v, coriolis)
    for i in range(3):
        for s in range(m):
            a = accel[i, s] + gravity[i, own[s]] - 2.0 * coriolis[i, s]
            # equation (12)
            p_out[i, s] = p[i, s] + moment[s] * (v[i, s] + moment[s] / 2.0 * (a + moment[s] / 3.0 * slope[i, s]))
    place(q, 0, 0, q_out)
    turn(q_out, theta, 1.0)

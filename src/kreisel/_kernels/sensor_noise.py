"""What white noise of the readings leaves in attitude, velocity and position along a path."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels.arrays import Array, PreparedReadings
from kreisel._kernels.compilation import kernel
from kreisel._kernels.increments import Increments, Span
from kreisel._kernels.rotation import direction_cosines


@kernel
def noise_covariance(
    span: Span,
    every: int,
    signal: PreparedReadings,
    motion: Increments,
    K_omega: Array,
    K_a: Array,
    Q: Array,
) -> None:
    """Write the covariance that sensor noise leaves in attitude, velocity and position, (9, 9): equation (10).

    Seen from the body's attitude at the first sample; attitude errors as left perturbations in that frame.
    `every` samples are taken together, with force and attitude in their middle.

    Parameters
    ----------
    motion
        The increments over the span.
    K_omega, K_a : (3, 3)

    Notes
    -----
    White noise of a density, and where samples are missing what interpolating across a gap of length h leaves,
    about h^3/12 times the second derivative the readings usually have.
    """
    stamps, density, missing = signal.stamps, signal.noise, 1.6 * signal.usual
    C = np.empty((1, 9))
    G = np.empty((3, 3))
    rate = np.empty(3)
    force = np.empty(3)
    Q[:] = 0.0
    for start in range(span.first, span.last, every):
        stop = min(start + every, span.last)
        middle = (start + stop) // 2 - span.low
        dt = stamps[stop] - stamps[start]
        bridged = 0.0
        for k in range(start, stop):
            h = stamps[k + 1] - stamps[k]
            if h > missing:
                bridged += (h * h * h / 12.0) ** 2
        for axis in range(3):
            rate[axis] = density[0, axis] * dt + density[2, axis] * density[2, axis] * bridged
            force[axis] = density[1, axis] * dt + density[3, axis] * density[3, axis] * bridged
        advance_covariance(motion.u_path[middle], dt, Q)
        direction_cosines(motion.q_path[middle : middle + 1], C)
        product(C, K_omega, G)
        add_noise(G, rate, 1.0, 0.0, 0, 0, Q)
        product(C, K_a, G)
        add_noise(G, force, 1.0, 0.5 * dt, 3, 6, Q)


@kernel
def product(A: Array, B: Array, out: Array) -> None:
    """Write the product (3, 3) of two matrices, A (1, 9) given row by row, and B (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, 3 * i] * B[0, j] + A[0, 3 * i + 1] * B[1, j] + A[0, 3 * i + 2] * B[2, j]


@kernel
def advance_covariance(u: Array, dt: float, Q: Array) -> None:
    """Replace Q (9, 9) by F Q F^T for errors that move as v += -u x theta dt, p += v dt - u x theta dt^2/2.

    theta, v and p are attitude error (left), velocity and position error; u (3,) the specific force.
    """
    ux, uy, uz = u[0], u[1], u[2]
    h = 0.5 * dt
    for j in range(9):
        x = -dt * (uy * Q[2, j] - uz * Q[1, j])
        y = -dt * (uz * Q[0, j] - ux * Q[2, j])
        z = -dt * (ux * Q[1, j] - uy * Q[0, j])
        Q[6, j] += dt * Q[3, j] + h * x
        Q[7, j] += dt * Q[4, j] + h * y
        Q[8, j] += dt * Q[5, j] + h * z
        Q[3, j] += x
        Q[4, j] += y
        Q[5, j] += z
    for i in range(9):
        x = -dt * (uy * Q[i, 2] - uz * Q[i, 1])
        y = -dt * (uz * Q[i, 0] - ux * Q[i, 2])
        z = -dt * (ux * Q[i, 1] - uy * Q[i, 0])
        Q[i, 6] += dt * Q[i, 3] + h * x
        Q[i, 7] += dt * Q[i, 4] + h * y
        Q[i, 8] += dt * Q[i, 5] + h * z
        Q[i, 3] += x
        Q[i, 4] += y
        Q[i, 5] += z


@kernel
def add_noise(G: Array, variance: Array, gain: float, gain_below: float, row: int, row_below: int, Q: Array) -> None:
    """Add G diag(variance) G^T to Q at `row`, and with its integral at `row_below` where gain_below > 0.

    G (3, 3), variance (3,), Q (9, 9).
    """
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += G[i, k] * variance[k] * G[j, k]
            Q[row + i, row + j] += gain * gain * total
            if gain_below > 0.0:
                Q[row_below + i, row + j] += gain_below * gain * total
                Q[row + i, row_below + j] += gain * gain_below * total
                # the noise is white within the interval: variance of its integral is dt^2/3, not dt^2/4
                Q[row_below + i, row_below + j] += 4.0 / 3.0 * gain_below * gain_below * total


@kernel
def navigation_noise(Q: Array, q_first: Array, dq: Array, out: Array) -> None:
    """Write the lower triangular factor (9, 9) of noise in velocity, position and attitude, in r, r and b.

    Q (9, 9): covariance of attitude, velocity and position as `noise_covariance` writes it. q_first (4,): attitude at
    the first sample; dq (4,): the turn from there to the last.
    """
    C = np.empty((1, 9))
    D = np.empty((1, 9))
    T = np.zeros((9, 9))
    direction_cosines(q_first.reshape(1, 4), C)
    direction_cosines(dq.reshape(1, 4), D)
    for i in range(3):
        for j in range(3):
            T[i, 3 + j] = C[0, 3 * i + j]
            T[3 + i, 6 + j] = C[0, 3 * i + j]
            T[6 + i, j] = D[0, 3 * j + i]
    TQ = np.zeros((9, 9))
    P = np.zeros((9, 9))
    for i in range(9):
        for k in range(9):
            if T[i, k] != 0.0:
                for j in range(9):
                    TQ[i, j] += T[i, k] * Q[k, j]
    for i in range(9):
        for j in range(9):
            for k in range(9):
                P[i, j] += TQ[i, k] * T[j, k]
    out[:] = 0.0
    for j in range(9):
        left = P[j, j]
        for k in range(j):
            left -= out[j, k] * out[j, k]
        # velocity and position noise are nearly the same thing over one sample
        out[j, j] = math.sqrt(max(left, 1e-13 * P[j, j], 1e-300))
        for i in range(j + 1, 9):
            total = P[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            out[i, j] = total / out[j, j]

"""Two reference integrations of section 4's equations: one nearly exact, one by samples and plain."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from .quaternions import Array, exp, multiply, normalized, rotate, rotate_back, skew


class Trajectory(NamedTuple):
    """Attitude q_rb (..., n, 4), velocity and position in r (..., n, 3)."""

    q: Array
    v: Array
    p: Array


def integrate(
    omega_ib_b: Callable[[float], Array],
    f_b: Callable[[float], Array],
    q0: Array,
    v0: Array,
    p0: Array,
    times: Array,
    gravity_r: Array,
    earth_rate_r: Array,
    rtol: float = 1e-13,
    atol: float = 1e-13,
) -> Trajectory:
    """Return attitude, velocity and position at `times`, the state being given at times[0].

    Parameters
    ----------
    omega_ib_b, f_b
        Functions of one time (s) giving rate (rad/s) and specific force (m/s^2), each (3,).
    times
        Increasing, (n,).
    rtol, atol
        Of SciPy's DOP853.
    """

    def slope(t: float, y: Array) -> Array:
        q, v = y[:4], y[4:7]
        unit = normalized(q)
        omega_rb_b = omega_ib_b(t) - rotate_back(unit, earth_rate_r)
        dq = 0.5 * multiply(q, np.concatenate([[0.0], omega_rb_b]))
        dv = rotate(unit, f_b(t)) + gravity_r - 2.0 * np.cross(earth_rate_r, v)
        return np.concatenate([dq, dv, v])

    start = np.concatenate([q0, v0, p0])
    span = (float(times[0]), float(times[-1]))
    solution = solve_ivp(slope, span, start, method="DOP853", t_eval=times, rtol=rtol, atol=atol)
    if not solution.success:
        raise RuntimeError(solution.message)
    y = solution.y.T
    return Trajectory(normalized(y[:, :4]), y[:, 4:7], y[:, 7:])


def central_differences(stamps: Array, samples: Array) -> Array:
    """Return d(samples)/dt along the last axis but one: central inside, one-sided parabolas at the ends."""
    return np.gradient(samples, stamps, axis=-2, edge_order=2)


def five_point_differences(stamps: Array, samples: Array) -> Array:
    """Return d(samples)/dt along the last axis but one, of the quartics through five neighbours.

    The two samples at either end have central or one-sided differences of three.
    """
    rates = central_differences(stamps, samples)
    n = len(stamps)
    if n < 5:
        return rates
    t = np.stack([stamps[i : n - 4 + i] for i in range(5)])
    inner = np.zeros_like(samples[..., 2:-2, :])
    for i in range(5):
        inner += _slope_weight(t, i)[:, None] * samples[..., i : n - 4 + i, :]
    rates[..., 2:-2, :] = inner
    return rates


def _slope_weight(t: Array, i: int) -> Array:
    """Return the slope at t[2] of the quartic that is one at t[i] and zero at the other four."""
    others = [j for j in range(5) if j != i]
    if i == 2:
        return np.sum([1.0 / (t[2] - t[j]) for j in others], axis=0)
    zeros = np.prod([t[2] - t[j] for j in others if j != 2], axis=0)
    return np.asarray(zeros / np.prod([t[i] - t[j] for j in others], axis=0))


def two_sample(
    stamps: Array,
    omega_ib_b: Array,
    f_b: Array,
    q0: Array,
    v0: Array,
    p0: Array,
    gravity_r: Array,
    earth_rate_r: Array,
    alpha: Array | None = None,
    f_rate: Array | None = None,
) -> Trajectory:
    """Return attitude, velocity and position at every sample, by the corrected two-sample rule.

    Parameters
    ----------
    stamps
        (n,) s, not necessarily even.
    omega_ib_b, f_b
        (n, 3) or (batch, n, 3): rate (rad/s) and specific force (m/s^2).
    q0, v0, p0, gravity_r, earth_rate_r
        (4,) and (3,), or with the leading batch axis.
    alpha, f_rate
        Derivatives of omega_ib_b and f_b, like them in shape; central differences of them where not given.

    Notes
    -----
    rotation vector = dt/2 (w_k + w_k+1) + dt^2/12 (alpha_k - alpha_k+1) + dt^2/12 w_k x w_k+1 turns b in
    i; the Earth's rate is removed in each step by exp(-earth_rate_r dt) from the left, which is exact for
    a rate constant in r. Velocity and position use dt/2 (x_k + x_k+1) + dt^2/12 (x'_k - x'_k+1).
    """
    alpha = central_differences(stamps, omega_ib_b) if alpha is None else alpha
    f_rate = central_differences(stamps, f_b) if f_rate is None else f_rate
    dt = np.diff(stamps)
    q = _attitudes(dt, omega_ib_b, alpha, q0, earth_rate_r)
    force_r = rotate(q, f_b) + gravity_r[..., None, :]
    omega_rb_b = omega_ib_b - rotate_back(q, np.broadcast_to(earth_rate_r[..., None, :], omega_ib_b.shape))
    force_rate_r = rotate(q, f_rate + np.cross(omega_rb_b, f_b))
    v, p = _velocities_and_positions(dt, force_r, force_rate_r, v0, p0, earth_rate_r)
    return Trajectory(q, v, p)


def corrected_trapezoid(dt: Array, x: Array, x_rate: Array) -> Array:
    """Return the integral of x over every interval, (..., n - 1, 3)."""
    dt = dt[:, None]
    total, change = x[..., 1:, :] + x[..., :-1, :], x_rate[..., 1:, :] - x_rate[..., :-1, :]
    return dt / 2.0 * total - dt**2 / 12.0 * change


def _attitudes(dt: Array, omega: Array, alpha: Array, q0: Array, earth_rate_r: Array) -> Array:
    coning = dt[:, None] ** 2 / 12.0 * np.cross(omega[..., :-1, :], omega[..., 1:, :])
    turn_b = exp(corrected_trapezoid(dt, omega, alpha) + coning)
    turn_r = exp(-dt[:, None] * earth_rate_r[..., None, :])
    q = np.empty((*omega.shape[:-1], 4), dtype=np.result_type(omega, q0))
    q[..., 0, :] = q0
    for k in range(len(dt)):
        q[..., k + 1, :] = multiply(multiply(turn_r[..., k, :], q[..., k, :]), turn_b[..., k, :])
    return q


def _velocities_and_positions(
    dt: Array, force_r: Array, force_rate_r: Array, v0: Array, p0: Array, earth_rate_r: Array
) -> tuple[Array, Array]:
    gain = corrected_trapezoid(dt, force_r, force_rate_r)
    twice_earth = 2.0 * skew(earth_rate_r)
    v, p = (np.empty(force_r.shape, dtype=np.result_type(force_r, v0, p0)) for _ in range(2))
    v[..., 0, :], p[..., 0, :] = v0, p0
    for k, h in enumerate(dt):
        a = force_r[..., k, :] - _times(twice_earth, v[..., k, :])
        step = h * v[..., k, :] + h**2 / 2.0 * a
        # The integral of the Coriolis term is -2 omega_ie x (step of p); two rounds settle it to rounding.
        for _ in range(2):
            v_next = v[..., k, :] + gain[..., k, :] - _times(twice_earth, step)
            a_next = force_r[..., k + 1, :] - _times(twice_earth, v_next)
            step = h / 2.0 * (v[..., k, :] + v_next) + h**2 / 12.0 * (a - a_next)
        v[..., k + 1, :], p[..., k + 1, :] = v_next, p[..., k, :] + step
    return v, p


def _times(A: Array, x: Array) -> Array:
    return (A @ x[..., None])[..., 0]

"""Start values for the accelerometers and gravity, by linear least squares before any filter runs.

The second difference of the reference's positions over half a second equals the readings' double
integral with a triangular weight. With the attitude known from gyros and reference together, that is
linear in K_a, K_a k_a0, a common lever arm and gravity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kreisel._kernels import unit_forces
from kreisel.estimation.robust import cauchy_weights, vector_scale
from kreisel.geometry.rotation import Array, lengths, nearest_rotation
from kreisel.inertial.strapdown import InertialSignal
from kreisel.preparation.preparation import AccelerationWindows, AccelerometerFit
from kreisel.synchronization.fits import RateFit
from kreisel.synchronization.windows import HALF_WINDOW, Windows

_HALF_WINDOW_WITHOUT_POSITIONS = 3.0
"""s; half of a window whose mean acceleration is taken for zero. Chosen: of positions within a metre of the middle it
is below 0.5 m/s^2, 4 m over 3 s squared; of longer ones there are fewer, and the attitude drifts in them."""

_STANDSTILL_WEIGHT = 20.0
"""Weight of a standstill, over that of a window without positions. Chosen: in a window the mean acceleration is some
tenths of m/s^2, at standstill a twentieth of that at most."""

_ROUNDS = 8
"""Solutions, each with weights by the residuals of the one before. Chosen: the result is a start value, with twenty
times its deviation (`start_values.START_INFLATION`), and need not be settled."""


def acceleration_windows(
    signal: InertialSignal,
    fit: RateFit,
    tau: Array,
    q: Array,
    p: Array | None,
    standstills: Sequence[tuple[float, float]],
) -> AccelerationWindows:
    """Return predicted and reference accelerations of a chunk of readings.

    Parameters
    ----------
    tau, p : (m,), (m, 3) or None
        Reference seconds and positions.
    q : (n, 4)
        Attitude q_rb at every sample.
    standstills
        First and last IMU second of every standstill.
    """
    windows = Windows.over(signal, fit.clock, tau, HALF_WINDOW if p is not None else _HALF_WINDOW_WITHOUT_POSITIONS)
    omega = np.ascontiguousarray(signal.rates @ fit.K_omega.T + fit.rate_at_zero)
    alpha = np.ascontiguousarray(signal.slopes @ fit.K_omega.T)
    sampled = (q, np.ascontiguousarray(signal.accelerations), omega, alpha)
    means = windows.means(
        3 * unit_forces.PARAMETERS, lambda *at: unit_forces.double_integrals(signal.stamps, *sampled, *at)
    )
    reference = np.zeros((len(means), 3)) if p is None else windows.second_difference(p)
    first, last = signal.stamps[[0, -1]]
    inside = [(start, stop) for start, stop in standstills if start >= first and stop <= last]
    at_standstill = [_mean_regressor(signal.stamps, sampled, *interval) for interval in inside] if p is None else []
    shape = (-1, 3, unit_forces.PARAMETERS)
    return AccelerationWindows(means.reshape(shape), reference, np.array(at_standstill).reshape(shape))


def joined(parts: Sequence[AccelerationWindows]) -> AccelerationWindows:
    """Return the windows of several chunks as one."""
    columns = zip(*((part.regressor, part.reference, part.standstill_regressor) for part in parts), strict=True)
    return AccelerationWindows(*(np.concatenate(column) for column in columns))


def _mean_regressor(stamps: Array, sampled: tuple[Array, ...], start: float, stop: float) -> Array:
    """Return the mean regressor over an interval, (45,)."""
    q, readings, omega, alpha = sampled
    part = range(*np.searchsorted(stamps, (start, stop)))
    out, total = np.empty(3 * unit_forces.PARAMETERS), np.zeros(3 * unit_forces.PARAMETERS)
    for k in part:
        unit_forces.at_sample(q[k], readings[k], omega[k], alpha[k], out)
        total += out
    return total / max(len(part), 1)


def fit_accelerometers(
    windows: AccelerationWindows, fit: RateFit, gravity: float, *, positions: bool
) -> AccelerometerFit:
    """Return start values of accelerometers and gravity.

    Parameters
    ----------
    gravity
        Its magnitude, m/s^2.
    positions
        Whether the reference has positions. Without them, only the standstills are known, and that accelerations are
        zero on average over seconds.
    """
    A, target = _with_gravity(windows.regressor), windows.reference
    R = nearest_rotation(fit.K_omega)
    predicted = A[:, :, :9] @ R.ravel()
    g = target.mean(axis=0) - predicted.mean(axis=0)
    g *= gravity / np.linalg.norm(g)
    slope = 1.0
    if positions:
        observed, expected = target - target.mean(axis=0), predicted - predicted.mean(axis=0)
        slope = float(np.sum(observed * expected) / max(np.sum(expected**2), 1e-12))
    else:
        A = np.concatenate([A, _STANDSTILL_WEIGHT * _with_gravity(windows.standstill_regressor)])
        target = np.zeros(A.shape[:2])
    solution, deviation, residual = _solve(A, target, R, g, gravity)
    K = solution[:9].reshape(3, 3)
    return AccelerometerFit(
        K_a=K,
        k_a0=np.asarray(np.linalg.solve(K, solution[9:12]), dtype=float),
        lever_arm=solution[12:15],
        gravity=solution[15:18],
        motion_slope=slope,
        residual_sd=residual,
        K_a_sd=deviation[:9].reshape(3, 3),
        k_a0_sd=deviation[9:12],
        lever_arm_sd=deviation[12:15],
        tilt_sd=float(np.max(deviation[15:18])) / gravity,
        windows=windows,
    )


def _with_gravity(regressor: Array) -> Array:
    """Return a regressor (n, 3, 15) with three columns for gravity."""
    return np.concatenate([regressor, np.broadcast_to(np.eye(3), (len(regressor), 3, 3))], axis=2)


def _solve(A: Array, target: Array, R: Array, g: Array, gravity: float) -> tuple[Array, Array, float]:
    """Solve with weak priors (axes near the gyros', offsets and lever arms near zero), robustly."""
    prior = np.concatenate([R.ravel(), np.zeros(6), g])
    x = prior.copy()
    normal = np.eye(18)
    weight = np.ones(target.shape[0])
    variance = 0.1
    for _ in range(_ROUNDS):
        along = x[15:18] / np.linalg.norm(x[15:18])
        prior[15:18] = gravity * along
        precision = np.diag(np.concatenate([np.full(9, 0.2**-2), np.full(3, 1.0), np.full(3, 0.3**-2), np.zeros(3)]))
        precision[15:18, 15:18] += np.outer(along, along) / 1e-4**2 + np.eye(3) / (0.5 * gravity) ** 2
        weighted = (weight[:, None, None] * A).reshape(-1, x.size).T
        # windows overlap by half or more and share their noise
        normal = weighted @ A.reshape(-1, x.size) / (2.0 * variance) + precision
        right = weighted @ target.ravel() / (2.0 * variance) + precision @ prior
        x = np.linalg.solve(normal, right)
        residual = lengths(target - A @ x)
        variance = max(vector_scale(residual) ** 2, 1e-10)
        weight = cauchy_weights(residual, 4.0 * variance**0.5)
    return x, np.sqrt(np.diag(np.linalg.inv(normal))), float(np.sqrt(variance))

"""Robust fit of the gyros' cross-coupling and offset, and of the clocks, to the reference's rotations.

The reference's rotation over short stretches (noisy) is regressed on the integrated gyro readings
(clean); the other way round the noise would make the scale factor too small.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from kreisel.errors import SynchronizationError
from kreisel.geometry.rotation import Array, Mask, conjugate, exp, log, multiply
from kreisel.inertial.strapdown import InertialSignal, integrate_attitude, linear_rate
from kreisel.recording import ReferencePoses
from kreisel.synchronization.clock import Clock

STRETCH = 0.4
"""Usual length of the stretches compared, s."""

LEAST_STRETCHES = 30
"""Stretches without which nothing is fitted."""

WANDER_PARTS = 12
"""Parts of a recording in which the clocks are compared once more."""


@dataclass(frozen=True)
class RateFit:
    """Gyro parameters and clock that bring integrated readings onto the reference's rotations.

    Attributes
    ----------
    K_omega : (3, 3)
    k_w0 : (3,)
        rad/s.
    clock
        With the standard deviations of the fit.
    skewed
        Whether the clocks run at different rates, or could, as far as this recording tells.
    explained
        Share of the reference's squared rotation the fit explains, 1 being all.
    residual_sd
        Standard deviation of what is left in a stretch, rad, each axis.
    K_omega_sd, k_w0_sd : (3, 3), (3,)
        Standard deviations of the fit.
    wander : (k, 3)
        What is left of a shift of the clocks in stretches of the recording: reference seconds of the middle,
        shift, its standard deviation. It is nothing but noise where both clocks run steadily.
    """

    K_omega: Array
    k_w0: Array
    clock: Clock
    skewed: bool
    explained: float
    residual_sd: float
    K_omega_sd: Array
    k_w0_sd: Array
    wander: Array = field(default_factory=lambda: np.zeros((0, 3)))


ROUNDS, SETTLED = 40, 0.1
"""Gauss-Newton steps at most; they end once none moves by more than this share of its standard deviation."""


@dataclass(frozen=True)
class _Stretches:
    """Reference rotations between pairs of stamps."""

    tau_first: Array
    tau_last: Array
    rotation: Array


@dataclass(frozen=True)
class _Readings:
    """Raw rates and their integral from the first sample, (n, 3), row by row."""

    signal: InertialSignal
    rates: Array
    integral: Array

    @classmethod
    def of(cls, signal: InertialSignal) -> _Readings:
        integral = np.zeros((signal.stamps.size, 3))
        np.cumsum(signal.integrals, axis=0, out=integral[1:])
        return cls(signal, np.ascontiguousarray(signal.rates), integral)


def rotations_between(tau: Array, q: Array, length: float) -> _Stretches:
    """Return the rotation vectors between poses about `length` apart."""
    stride = max(1, round(length / float(np.median(np.diff(tau)))))
    step = max(1, stride // 8)
    first = np.arange(0, tau.size - stride, step)
    rotation = log(multiply(conjugate(q[first]), q[first + stride]))
    good = (np.linalg.norm(rotation, axis=1) < 2.5) & (tau[first + stride] - tau[first] < 3.0 * length)
    return _Stretches(tau[first][good], tau[first + stride][good], rotation[good])


def explained_share(signal: InertialSignal, tau: Array, q: Array, clock: Clock) -> float:
    """Return the share of the reference's rotation a linear map of the readings explains, without refinement."""
    stretches = _short(tau, q)
    inside = _inside(signal, stretches, clock)
    turned, duration = _integrated(_Readings.of(signal), stretches, clock, inside)
    A = np.hstack([turned, duration[:, None]])
    target = stretches.rotation[inside]
    solution, *_ = np.linalg.lstsq(A, target, rcond=None)
    total = float(np.sum((target - target.mean(axis=0)) ** 2))
    return 1.0 - float(np.sum((target - A @ solution) ** 2)) / max(total, 1e-30)


def _inside(signal: InertialSignal, stretches: _Stretches, clock: Clock) -> Mask:
    """Return which stretches lie within the IMU's recording."""
    t = signal.stamps
    t1, t2 = clock.imu_time(stretches.tau_first), clock.imu_time(stretches.tau_last)
    return np.asarray((t1 > t[1]) & (t2 < t[-2]) & _unbroken(signal, t1, t2))


def _integrated(readings: _Readings, stretches: _Stretches, clock: Clock, inside: Mask) -> tuple[Array, Array]:
    """Return integrated readings over the stretches inside, and durations."""
    t = readings.signal.stamps
    ends = [clock.imu_time(tau[inside]) for tau in (stretches.tau_first, stretches.tau_last)]
    at = []
    for end in ends:
        k = np.searchsorted(t, end) - 1
        share = ((end - t[k]) / (t[k + 1] - t[k]))[:, None]
        at.append((1.0 - share) * readings.integral[k] + share * readings.integral[k + 1])
    return at[1] - at[0], ends[1] - ends[0]


def _unbroken(signal: InertialSignal, t1: Array, t2: Array) -> Mask:
    """Return which stretches lie within one segment of the signal: nothing is known across a gap."""
    if len(signal.segments) == 1:
        return np.ones(t1.size, dtype=bool)
    starts, stops = (signal.stamps[np.array(ends)] for ends in zip(*signal.segments, strict=True))
    segment = np.clip(np.searchsorted(starts, t1, side="right") - 1, 0, starts.size - 1)
    return np.asarray((t1 >= starts[segment]) & (t2 <= stops[segment]))


def check_overlap(signal: InertialSignal, reference: ReferencePoses, clock: Clock) -> None:
    """Raise an error if too little of the reference's rotation lies within the IMU's recording.

    Raises
    ------
    SynchronizationError
        With the seconds and stretches that do.
    """
    assert reference.quaternions is not None  # noqa: S101 - for the type checker; the callers looked
    for stretches in (
        _short(reference.seconds, reference.quaternions),
        _long(reference.seconds, reference.quaternions),
    ):
        inside = _inside(signal, stretches, clock)
        if int(inside.sum()) >= LEAST_STRETCHES:
            continue
        first, last = stretches.tau_first[inside], stretches.tau_last[inside]
        covered = float(last.max() - first.min()) if first.size else 0.0
        raise SynchronizationError(
            f"{reference.source}: overlaps with the IMU's recording by {covered:.1f} s, in {first.size} stretches that "
            f"can be compared, expected {LEAST_STRETCHES} or more: are both of one run, and are poses frequent enough?"
        )


def _short(tau: Array, q: Array) -> _Stretches:
    return rotations_between(tau, q, max(0.15, float(np.median(np.diff(tau)))))


def _long(tau: Array, q: Array) -> _Stretches:
    return rotations_between(tau, q, max(STRETCH, 4.0 * float(np.median(np.diff(tau)))))


def fit_rates(signal: InertialSignal, tau: Array, q: Array, clock: Clock) -> RateFit:
    """Return the robust least squares fit of gyro parameters and clock.

    Parameters
    ----------
    signal
        Readings prepared for integration.
    tau, q : (m,), (m, 4)
        Reference seconds and attitudes q_rb.
    clock
        First guess, good to a tenth of a second.

    Notes
    -----
    Enough of the reference must lie within the IMU's recording, see `check_overlap`.
    """
    stretches = _long(tau, q)
    readings = _Readings.of(signal)
    inside = _inside(signal, stretches, clock)
    turned, duration = _integrated(readings, stretches, clock, inside)
    A = np.hstack([turned, duration[:, None]])
    solution, *_ = np.linalg.lstsq(A, stretches.rotation[inside], rcond=None)
    K, b = np.asarray(solution[:3].T, dtype=float), np.asarray(solution[3], dtype=float)
    fit = _settle(readings, stretches, K, b, clock, skewed=True)
    # A ratio that cannot be told from one is dropped, unless it could shift the ends by a millisecond.
    doubt = max(4.0 * fit.clock.skew_sd, 1e-6)
    if abs(fit.clock.skew) < doubt and fit.clock.skew_sd * float(np.ptp(tau)) < 1e-3:
        clock = replace(fit.clock, start=fit.clock.start + fit.clock.skew * float(np.mean(tau)), skew=0.0)
        fit = _settle(readings, stretches, fit.K_omega, fit.K_omega @ fit.k_w0, clock, skewed=False)
    return replace(fit, wander=_wander(_compare(readings, stretches, fit.K_omega, fit.K_omega @ fit.k_w0, fit.clock)))


def _settle(readings: _Readings, stretches: _Stretches, K: Array, b: Array, clock: Clock, *, skewed: bool) -> RateFit:
    """Refine until nothing moves any more."""
    fit = _refine(readings, stretches, K, b, clock, skewed=skewed)
    for _ in range(ROUNDS - 1):
        before = fit
        fit = _refine(readings, stretches, fit.K_omega, fit.K_omega @ fit.k_w0, fit.clock, skewed=skewed)
        if _moved(before, fit) < SETTLED:
            break
    return fit


def _moved(before: RateFit, after: RateFit) -> float:
    """Return the largest change between two fits, in standard deviations."""
    steps = (
        (after.K_omega - before.K_omega, after.K_omega_sd),
        (after.k_w0 - before.k_w0, after.k_w0_sd),
        (after.clock.start - before.clock.start, after.clock.start_sd),
        (after.clock.skew - before.clock.skew, after.clock.skew_sd),
    )
    return max(float(np.max(np.abs(step) / np.maximum(sd, 1e-12))) for step, sd in steps)


@dataclass(frozen=True)
class _Comparison:
    """Stretches inside the IMU's recording, as the reference turned and as the readings say.

    Attributes
    ----------
    turned, duration
        Integrated readings and lengths of the stretches.
    tau : (n,)
        Their middles.
    rotation, residual : (n, 3)
        The reference's rotation, and what is left of it once the predicted one is taken off.
    slope : (n, 3)
        Change of the predicted rotation with a shift of the clock.
    """

    turned: Array
    duration: Array
    tau: Array
    rotation: Array
    residual: Array
    slope: Array


def _compare(readings: _Readings, stretches: _Stretches, K: Array, b: Array, clock: Clock) -> _Comparison:
    signal = readings.signal
    q = integrate_attitude(signal, linear_rate(K, b, signal.order))
    inside = _inside(signal, stretches, clock)
    turned, duration = _integrated(readings, stretches, clock, inside)
    t1, t2 = clock.imu_time(stretches.tau_first[inside]), clock.imu_time(stretches.tau_last[inside])
    q1, w1 = _attitude_at(readings, q, K, b, t1)
    q2, w2 = _attitude_at(readings, q, K, b, t2)
    predicted = multiply(conjugate(q1), q2)
    rotation = stretches.rotation[inside]
    return _Comparison(
        turned,
        duration,
        tau=0.5 * (stretches.tau_first + stretches.tau_last)[inside],
        rotation=rotation,
        residual=log(multiply(conjugate(predicted), exp(rotation))),
        # At the end of the stretch; the rate at its beginning is seen through the rotation between.
        slope=w2 - _turn_back(predicted, w1),
    )


def _refine(readings: _Readings, stretches: _Stretches, K: Array, b: Array, clock: Clock, *, skewed: bool) -> RateFit:
    """One Gauss-Newton step on the exact rotation residuals, robustly weighted."""
    seen = _compare(readings, stretches, K, b, clock)
    residual, slope = seen.residual, seen.slope
    weight = _robust_weight(residual)
    pivot = float(seen.tau.mean())
    columns = 12 + (2 if skewed else 1)
    A = np.zeros((residual.shape[0], 3, columns))
    for i in range(3):
        A[:, i, 3 * i : 3 * i + 3] = seen.turned
        A[:, i, 9 + i] = seen.duration
        A[:, i, 12] = slope[:, i]
        if skewed:
            A[:, i, 13] = slope[:, i] * (seen.tau - pivot)
    root = np.sqrt(weight)[:, None]
    stacked = (A * root[..., None]).reshape(-1, columns)
    target = (residual * root).reshape(-1)
    normal = stacked.T @ stacked
    normal += np.diag(1e-12 * np.diag(normal) + 1e-30)
    solution = np.linalg.solve(normal, stacked.T @ target)
    left = target - stacked @ solution
    variance = float(left @ left / max(float(3 * weight.sum()) - columns, 1.0))
    # Neighbouring stretches overlap eightfold and share their noise.
    covariance = 8.0 * variance * np.linalg.inv(normal)
    K_new = K + solution[:9].reshape(3, 3)
    b_new = b + solution[9:12]
    skew_step = float(solution[13]) if skewed else 0.0
    clock = Clock(
        start=clock.start + float(solution[12]) - skew_step * pivot,
        skew=clock.skew + skew_step,
        start_sd=float(np.sqrt(covariance[12, 12] + (pivot**2 * covariance[13, 13] if skewed else 0.0))),
        skew_sd=float(np.sqrt(covariance[13, 13])) if skewed else 0.0,
    )
    total = float(np.sum(weight[:, None] * (seen.rotation - seen.rotation.mean(axis=0)) ** 2))
    return RateFit(
        K_omega=K_new,
        k_w0=np.linalg.lstsq(K_new, b_new, rcond=None)[0],  # an axis that never turned leaves K singular
        clock=clock,
        skewed=skewed,
        explained=1.0 - float(left @ left) / max(total, 1e-30),
        residual_sd=float(np.sqrt(variance)),
        K_omega_sd=np.sqrt(np.diag(covariance)[:9]).reshape(3, 3),
        k_w0_sd=np.sqrt(np.diag(covariance)[9:12]),
    )


def _wander(seen: _Comparison) -> Array:
    """Return middle, shift and its standard deviation in a dozen parts of the recording, (k, 3)."""
    edges = np.linspace(seen.tau.min(), seen.tau.max() + 1e-9, WANDER_PARTS + 1)
    found = []
    for low, high in pairwise(edges):
        part = (seen.tau >= low) & (seen.tau < high)
        slope, residual = seen.slope[part], seen.residual[part]
        if part.sum() < 10:
            continue
        shift = 0.0
        for _ in range(5):
            weight = _robust_weight(residual - shift * slope)[:, None]
            normal = float(np.sum(weight * slope**2))
            shift = float(np.sum(weight * slope * residual)) / max(normal, 1e-30)
        left = float(np.sum(weight * (residual - shift * slope) ** 2))
        # neighbouring stretches overlap eightfold and share their noise
        variance = 8.0 * left / (3.0 * float(weight.sum())) / max(normal, 1e-30)
        found.append((float(np.mean(seen.tau[part])), shift, float(np.sqrt(variance))))
    return np.array(found).reshape(-1, 3)


def _attitude_at(readings: _Readings, q: Array, K: Array, b: Array, t: Array) -> tuple[Array, Array]:
    """Return attitude and rate at times between samples, of attitudes (n, 4) at the samples."""
    stamps = readings.signal.stamps
    k = np.clip(np.searchsorted(stamps, t) - 1, 0, stamps.size - 2)
    s = (t - stamps[k])[:, None]
    h = (stamps[k + 1] - stamps[k])[:, None]
    omega, after = (readings.rates[at] @ K.T + b for at in (k, k + 1))
    slope = (after - omega) / h
    return multiply(q[k], exp(omega * s + 0.5 * slope * s**2)), omega + slope * s


def _turn_back(q: Array, v: Array) -> Array:
    t = 2.0 * np.cross(-q[:, 1:], v)
    return np.asarray(v + q[:, :1] * t + np.cross(-q[:, 1:], t))


def _robust_weight(residual: Array) -> Array:
    """Return Cauchy weights with the scale of the median."""
    size = np.linalg.norm(residual, axis=1)
    scale = float(np.median(size)) / 1.538 + 1e-12  # median length of a three-dimensional normal vector
    return np.asarray(1.0 / (1.0 + (size / (4.0 * scale)) ** 2))

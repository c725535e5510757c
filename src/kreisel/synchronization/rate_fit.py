"""Robust fit of the gyros' cross-coupling and offset, and of the clocks, to the reference's rotations.

The rotation of the reference over short times (noisy) is regressed on the integrated gyro readings
(clean); the reverse regression would make the scale factor too small because of the noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from kreisel._kernels.rotation_fit import RateSignal, compare_rotations
from kreisel.errors import SynchronizationError
from kreisel.estimation.robust import cauchy_weights, vector_scale
from kreisel.geometry.interpolation import running_mean
from kreisel.geometry.rotation import Array, conjugate, lengths, log, multiply
from kreisel.inertial.readings import Readings
from kreisel.inertial.strapdown import InertialSignal, integrate_attitude, linear_rate
from kreisel.recording.recording import ReferencePoses
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import RateFit

ROTATION_SECONDS = 0.4
"""Usual time over which rotations are compared, s."""

MIN_ROTATIONS = 30
"""Rotations needed for a fit."""

CLOCK_DRIFT_PARTS = 12
"""Parts of a recording in which the residual clock drift is found."""


SMOOTHED = 0.05
"""Seconds over which rates are averaged for the derivative of a rotation with respect to a shift of the clock: the
noise of single readings would appear as information on the shift."""

ROUNDS, SETTLED = 40, 0.1
"""Largest number of Gauss-Newton steps; they end once no value moves by more than this share of its deviation."""


@dataclass(frozen=True)
class _Rotations:
    """Reference rotations between pairs of stamps."""

    tau_first: Array
    tau_last: Array
    rotation: Array

    def inside(self, signal: InertialSignal | Readings, clock: Clock) -> _Rotations:
        """Return the rotations that lie within one segment: nothing is known across a gap."""
        t, ends = signal.stamps, (clock.imu_time(self.tau_first), clock.imu_time(self.tau_last))
        good = (ends[0] > t[1]) & (ends[1] < t[-2])
        if not signal.segments:
            good[:] = False
        elif signal.segments != ((0, t.size - 1),):
            starts, stops = (t[np.array(edges, dtype=int)] for edges in zip(*signal.segments, strict=True))
            segment = np.clip(np.searchsorted(starts, ends[0], side="right") - 1, 0, starts.size - 1)
            good &= (ends[0] >= starts[segment]) & (ends[1] <= stops[segment])
        return _Rotations(self.tau_first[good], self.tau_last[good], self.rotation[good])


@dataclass(frozen=True)
class _Integrated:
    """Raw rates of a chunk of readings, their running means, and their integral from its first sample, (n, 3)."""

    signal: InertialSignal
    rates: Array
    smooth: Array
    integral: Array

    @classmethod
    def of(cls, signal: InertialSignal) -> _Integrated:
        integral = np.zeros((signal.stamps.size, 3))
        np.cumsum(signal.integrals, axis=0, out=integral[1:])
        # many of these are in memory at once: only what the integration of the rates needs is kept
        none = np.empty((0, 0))
        slim = signal.samples._replace(single=none, twice=none, slopes=none, forces=none)
        rates = np.ascontiguousarray(signal.rates)
        width = max(1, round(SMOOTHED / max(float(np.median(np.diff(signal.stamps[:1000]))), 1e-6)))
        return cls(replace(signal, samples=slim), rates, running_mean(rates, width), integral)

    @property
    def rate_signal(self) -> RateSignal:
        """The rates as the library takes them."""
        return RateSignal(self.signal.stamps, self.rates, self.smooth, self.integral)

    def between(self, t1: Array, t2: Array) -> Array:
        """Return integrated readings from times t1 to times t2, (m, 3)."""
        t, at = self.signal.stamps, []
        for end in (t1, t2):
            k = np.searchsorted(t, end) - 1
            share = ((end - t[k]) / (t[k + 1] - t[k]))[:, None]
            at.append((1.0 - share) * self.integral[k] + share * self.integral[k + 1])
        return np.asarray(at[1] - at[0])


def rotations_between(tau: Array, q: Array, length: float) -> _Rotations:
    """Return the rotation vectors between poses about `length` apart."""
    stride = max(1, round(length / float(np.median(np.diff(tau)))))
    step = max(1, stride // 8)
    first = np.arange(0, tau.size - stride, step)
    rotation = log(multiply(conjugate(q[first]), q[first + stride]))
    good = (lengths(rotation) < 2.5) & (tau[first + stride] - tau[first] < 3.0 * length)
    return _Rotations(tau[first][good], tau[first + stride][good], rotation[good])


def explained_share(readings: Readings, tau: Array, q: Array, clock: Clock) -> float:
    """Return the share of the reference's short rotations a linear map of the readings explains."""
    return fit_linear_rates(readings, tau, q, clock)[1]


def fit_linear_rates(readings: Readings, tau: Array, q: Array, clock: Clock) -> tuple[Array, float]:
    """Return the matrix (3, 3) of readings that explains the reference's rotation best, and the share it explains."""
    solution, share = _linear_fit(_excerpt(readings, tau, clock), _short(tau, q), clock)
    return solution[:3].T.copy(), share


@dataclass(frozen=True)
class LinearFit:
    """Linear map of integrated readings onto the reference's rotations, from which the clock is refined.

    Attributes
    ----------
    parts
        Readings of which it is; of a long recording, chunks spread evenly.
    rotations
        The reference's.
    clock
    solution : (4, 3)
        The map of integrated readings, and of time.
    explained
        Share of the squared rotation that it explains.
    """

    parts: Sequence[_Integrated]
    rotations: _Rotations
    clock: Clock
    solution: Array
    explained: float

    @classmethod
    def of(cls, readings: Readings, tau: Array, q: Array, clock: Clock) -> LinearFit:
        """Return the fit to a reference's attitudes q (m, 4) at seconds tau (m,)."""
        rotations, parts = _long(tau, q), list(_excerpt(readings, tau, clock))
        return cls(parts, rotations, clock, *_linear_fit(parts, rotations, clock))


def _excerpt(readings: Readings, tau: Array, clock: Clock) -> Iterator[_Integrated]:
    """Yield chunks of readings, spread evenly over a reference's time."""
    return (_Integrated.of(part) for part in readings.excerpt(*clock.imu_time(tau[[0, -1]])))


def _linear_fit(parts: Iterable[_Integrated], rotations: _Rotations, clock: Clock) -> tuple[Array, float]:
    """Return the map (4, 3) of integrated readings and time onto rotations, and the share of these it explains."""
    rows, targets = [], []
    for part in parts:
        within = rotations.inside(part.signal, clock)
        t1, t2 = clock.imu_time(within.tau_first), clock.imu_time(within.tau_last)
        rows.append(np.column_stack([part.between(t1, t2), t2 - t1]))
        targets.append(within.rotation)
    A, target = np.concatenate(rows), np.concatenate(targets)
    solution, *_ = np.linalg.lstsq(A, target, rcond=None)
    left, spread = target - A @ solution, target - target.mean(axis=0)
    return np.asarray(solution), 1.0 - float(np.vdot(left, left)) / max(float(np.vdot(spread, spread)), 1e-30)


def check_overlap(readings: Readings, reference: ReferencePoses, clock: Clock) -> None:
    """Raise an error if too little of the reference's rotation lies within the IMU's recording.

    Raises
    ------
    SynchronizationError
        With the seconds and the rotations that do.
    """
    assert reference.quaternions is not None  # noqa: S101 - for the type checker; the callers checked
    for rotations in (
        _short(reference.seconds, reference.quaternions),
        _long(reference.seconds, reference.quaternions),
    ):
        inside = rotations.inside(readings, clock)
        first, last = inside.tau_first, inside.tau_last
        if first.size >= MIN_ROTATIONS:
            continue
        covered = float(last.max() - first.min()) if first.size else 0.0
        raise SynchronizationError(
            f"{reference.source}: overlaps with the IMU's recording by {covered:.1f} s, in {first.size} rotations that "
            f"can be compared, expected {MIN_ROTATIONS} or more: are both of one run, and are poses frequent enough?"
        )


def _short(tau: Array, q: Array) -> _Rotations:
    return rotations_between(tau, q, max(0.15, float(np.median(np.diff(tau)))))


def _long(tau: Array, q: Array) -> _Rotations:
    return rotations_between(tau, q, max(ROTATION_SECONDS, 4.0 * float(np.median(np.diff(tau)))))


def fit_rates(readings: Readings, linear: LinearFit) -> RateFit:
    """Return the robust least squares fit of gyro parameters and clock.

    Parameters
    ----------
    linear
        The fit by a first guess of the clock, accurate to a tenth of a second.

    Notes
    -----
    Enough of the reference must lie within the IMU's recording, see `check_overlap`.
    """
    parts, rotations, solution = linear.parts, linear.rotations, linear.solution
    fit = _settle(parts, rotations, solution[:3].T.copy(), solution[3], linear.clock)
    everything = parts if len(parts) == readings.count else (_Integrated.of(part) for part in readings.chunks())
    seen = _compare(everything, rotations, fit.K_omega, fit.rate_at_zero, fit.clock)
    return replace(fit, clock_drift=_clock_drift(seen))


def _settle(parts: Sequence[_Integrated], rotations: _Rotations, K: Array, b: Array, clock: Clock) -> RateFit:
    """Refine until the steps are below `SETTLED`."""
    fit = _refine(parts, rotations, K, b, clock)
    for _ in range(ROUNDS - 1):
        before = fit
        fit = _refine(parts, rotations, fit.K_omega, fit.rate_at_zero, fit.clock)
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
class Comparison:
    """Rotations within the IMU's recording, as measured by the reference and as predicted by the readings.

    Attributes
    ----------
    turned, duration
        Integrated readings over the rotations, and the durations of these, s.
    tau : (n,)
        Their middles.
    rotation, residual : (n, 3)
        The reference's rotation, and its difference from the predicted one.
    slope : (n, 3)
        Derivative of the predicted rotation with respect to a shift of the clock.
    """

    turned: Array
    duration: Array
    tau: Array
    rotation: Array
    residual: Array
    slope: Array


def _compare(parts: Iterable[_Integrated], rotations: _Rotations, K: Array, b: Array, clock: Clock) -> Comparison:
    """Return how the rotations compare in all parts together."""
    found = [_compare_in(part, rotations, K, b, clock) for part in parts]
    return Comparison(*(np.concatenate([getattr(one, f.name) for one in found]) for f in fields(Comparison)))


def _compare_in(part: _Integrated, rotations: _Rotations, K: Array, b: Array, clock: Clock) -> Comparison:
    q = integrate_attitude(part.signal, linear_rate(K, b))
    within = rotations.inside(part.signal, clock)
    t = np.column_stack([clock.imu_time(within.tau_first), clock.imu_time(within.tau_last)])
    turned, residual, slope = compare_rotations(part.rate_signal, q, np.ascontiguousarray(K), b, t, within.rotation)
    middle = 0.5 * (within.tau_first + within.tau_last)
    return Comparison(turned, t[:, 1] - t[:, 0], middle, within.rotation, residual, slope)


def _refine(parts: Sequence[_Integrated], rotations: _Rotations, K: Array, b: Array, clock: Clock) -> RateFit:
    """One Gauss-Newton step on the exact rotation residuals, robustly weighted."""
    seen = _compare(parts, rotations, K, b, clock)
    residual, slope = seen.residual, seen.slope
    weight = _weights(residual)
    pivot = float(seen.tau.mean())
    places = [[3 * i, 3 * i + 1, 3 * i + 2, 9 + i, 12, 13] for i in range(3)]
    columns = [
        np.column_stack([seen.turned, seen.duration, along, along * (seen.tau - pivot)]) for along in slope.T
    ]  # of one axis
    normal, right = np.diag(np.full(14, 1e-30)), np.zeros(14)
    for place, own, of_axis in zip(places, columns, residual.T, strict=True):
        weighted = own * weight[:, None]
        normal[np.ix_(place, place)] += weighted.T @ own
        right[place] += of_axis @ weighted
    normal += np.diag(1e-12 * np.diag(normal))
    solution = np.linalg.solve(normal, right)
    left = residual - np.column_stack([own @ solution[place] for place, own in zip(places, columns, strict=True)])
    squares = float(weight @ np.einsum("ni,ni->n", left, left))
    variance = squares / max(float(3 * weight.sum()) - right.size, 1.0)
    # Neighbouring rotations overlap eightfold and share their noise.
    covariance = 8.0 * variance * np.linalg.inv(normal)
    K_new = K + solution[:9].reshape(3, 3)
    b_new = b + solution[9:12]
    skew_step = float(solution[13])
    clock = Clock(
        start=clock.start + float(solution[12]) - skew_step * pivot,
        skew=clock.skew + skew_step,
        start_sd=float(np.sqrt(covariance[12, 12] + pivot**2 * covariance[13, 13])),
        skew_sd=float(np.sqrt(covariance[13, 13])),
    )
    total = float(np.sum(weight[:, None] * (seen.rotation - seen.rotation.mean(axis=0)) ** 2))
    return RateFit(
        K_omega=K_new,
        k_w0=np.linalg.lstsq(K_new, b_new, rcond=None)[0],  # an axis that never turned leaves K singular
        clock=clock,
        skewed=True,
        explained=1.0 - squares / max(total, 1e-30),
        residual_sd=float(np.sqrt(variance)),
        K_omega_sd=np.sqrt(np.diag(covariance)[:9]).reshape(3, 3),
        k_w0_sd=np.sqrt(np.diag(covariance)[9:12]),
    )


def turn_errors(
    readings: Readings, tau: Array, q: Array, fit: RateFit, clocks: tuple[Clock, Clock]
) -> tuple[Array, Array, Array]:
    """Return the middles of the rotations (n,), and their squared residuals by the gyros and either of two clocks."""
    rotations, found = _short(tau, q), []
    for clock in clocks:
        seen = _compare(
            (_Integrated.of(part) for part in readings.chunks()), rotations, fit.K_omega, fit.rate_at_zero, clock
        )
        found.append(dict(zip(seen.tau.tolist(), np.sum(seen.residual**2, axis=1).tolist(), strict=True)))
    middle = sorted(found[0].keys() & found[1].keys())
    first, second = (np.array([errors[t] for t in middle]) for errors in found)
    return np.array(middle), first, second


def steps_between(readings: Readings, tau: Array, q: Array, fit: RateFit) -> Comparison:
    """Return how the rotations between neighbouring poses compare with those by the gyros.

    Of a long recording, in chunks spread evenly.
    """
    rotations = rotations_between(tau, q, float(np.median(np.diff(tau))))
    return _compare(_excerpt(readings, tau, fit.clock), rotations, fit.K_omega, fit.rate_at_zero, fit.clock)


def _clock_drift(seen: Comparison) -> Array:
    """Return middle, shift and its standard deviation in a dozen parts of the recording, (k, 3)."""
    edges = np.linspace(seen.tau.min(), seen.tau.max() + 1e-9, CLOCK_DRIFT_PARTS + 1)
    found = []
    for low, high in pairwise(edges):
        part = (seen.tau >= low) & (seen.tau < high)
        slope, residual = seen.slope[part], seen.residual[part]
        if part.sum() < 10:
            continue
        shift = 0.0
        for _ in range(5):
            weight = _weights(residual - shift * slope)[:, None]
            normal = float(np.sum(weight * slope**2))
            shift = float(np.sum(weight * slope * residual)) / max(normal, 1e-30)
        left = float(np.sum(weight * (residual - shift * slope) ** 2))
        # neighbouring rotations overlap eightfold and share their noise
        variance = 8.0 * left / (3.0 * float(weight.sum())) / max(normal, 1e-30)
        found.append((float(np.mean(seen.tau[part])), shift, float(np.sqrt(variance))))
    return np.array(found).reshape(-1, 3)


def _weights(residual: Array) -> Array:
    """Return weights of residuals (n, 3) with the scale of their median."""
    size = lengths(residual)
    return cauchy_weights(size, 4.0 * (vector_scale(size) + 1e-12))

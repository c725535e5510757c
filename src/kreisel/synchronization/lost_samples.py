"""Samples or poses that were lost without a gap in their stamps, found by comparison of IMU and reference.

A program that counts samples instead of stamping them does not notice when one is lost: all later stamps are too early
by one interval, and of samples the rotation during that interval is missing in the integral of the rates. Both show in
the difference of the attitudes by gyros and by reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.interpolation import running_mean
from kreisel.geometry.rotation import Array, Indices, Mask, apply, conjugate, exp, lengths, log, multiply
from kreisel.inertial.readings import Readings, attitudes_at
from kreisel.inertial.strapdown import linear_rate
from kreisel.recording.recording import DataWarning, ImuSamples, ReferencePoses, Stamps
from kreisel.synchronization.fits import RateFit

_EVEN, _EVEN_SHARE = 2e-3, 0.999
"""Deviation of steps, in intervals, and share of all steps, by which stamps count as counted."""

_STEP = 0.04
"""Minimum time between two poses that are used, s."""

_PER_PLACE, _PER_SAMPLE, _PER_DRIFT = 8.0, 8.0, 12.0
"""Price in chi-square of a place with lost samples, of each sample lost there, and of a small change of the clocks."""

_PARTS = 4
"""Of the interval, in steps of which shifts are tried."""

_MAX_AT_ONCE = 3
"""Samples lost between two poses that are used."""

_MIN_GAIN, _ALIKE = 50.0, 10.0
"""Chi-square by which lost samples must be better than a slower clock, and may be worse than a clock that only jumps:
at rest the two are the same. With the first, none were found where none are lost (decision 17 in docs/decisions); the
second is chosen."""

_FASTEST_CRYSTAL = 3e-4
"""Ratio of clocks, less one, from which it may be that of many lost poses. Chosen: that of two crystals is smaller."""

_UNEVEN, _BEYOND = 0.05, 8.0
"""Intervals and deviations by which a part's shift is off that makes losses worth looking for. Chosen: parts of a
recording in which one sample after the other is lost average to a tenth of an interval."""

_MAX_WORK = 50_000_000
"""Poses times shifts that are tried. Chosen: 14 bytes are kept of each, 0.7 GB."""

_SURE = 80.0
"""Chi-square by which another place of lost samples is excluded."""

_LITTLE = (2e-4, 2e-4)
"""m and rad; motion during one interval that poses hardly show."""

_CAP = 25.0
"""Largest chi-square of one pose, three components. Chosen: five deviations; a single outlier costs no more, and does
not decide which path is the best."""

_FARTHEST = 0.1
"""Largest shift of the clock beside the straight line, s."""

_SCALE_ERROR, _RATE_ERROR = 1e-3, 3e-4
"""Of the gyros' preliminary matrix, and of their rates, rad/s lasting a second, which let the attitudes drift apart."""

_NAMED = 8  # places named in the warning; chosen: it stays a short one

_ANYWHERE = 2.0 / 3.0
"""Share of the recording in which a lost sample may lie anywhere, above which it may as well be a ratio of the clocks.
Chosen: in 15 simulated recordings with lost samples it was up to a sixth in the median of their places; where gyros
erred by a degree per second in ways nobody listed, all of it."""

_ROUNDS = 4
"""Searches with the noise of the one before. Chosen: they end once the noise changes by less than a tenth."""


@dataclass(frozen=True)
class _Losses:
    """Samples or poses that were lost without a gap.

    Attributes
    ----------
    places, counts : (k,)
        Numbers of those after them, and how many at each place.
    interval_ns
        Of the stamps.
    unsure : (k, 2)
        Reference seconds between which each place lies for sure.
    """

    places: Indices
    counts: Indices
    interval_ns: int
    unsure: Array

    def later(self, stamps_ns: Stamps) -> Stamps:
        """Return counted stamps, later after the losses."""
        missing = np.zeros(stamps_ns.size, dtype=np.int64)
        np.add.at(missing, self.places, self.counts)
        return np.asarray(stamps_ns + self.interval_ns * np.cumsum(missing))

    def unsure_poses(self, reference: ReferencePoses) -> Mask:
        """Return which poses depend on where exactly the losses were: between these moments, and in motion."""
        tau = reference.seconds
        inside = np.zeros(tau.size, dtype=bool)
        for low, high in self.unsure:
            inside |= (tau >= low) & (tau <= high)
        return inside & _moving(reference, 1e-9 * self.interval_ns)

    def named(self, seconds: Array) -> str:
        """Return the first places in words, by the seconds of all samples or poses."""
        at = seconds[self.places]
        more = f" and {at.size - _NAMED} more places" if at.size > _NAMED else ""
        return f"{', '.join(f'{t:.1f}' for t in at[:_NAMED])} s{more}"


@dataclass(frozen=True)
class LostSamples(_Losses):
    """Samples that were lost without a gap.

    Attributes
    ----------
    faster
        Share by which the sensor measures faster than it is asked, if that is why.
    """

    faster: float = 0.0

    def sure_poses(self, reference: ReferencePoses) -> Mask:
        """Return which poses do not depend on where exactly samples were lost."""
        return ~self.unsure_poses(reference)

    def max_within(self, seconds: float) -> int:
        """Return the largest number of samples lost within some seconds."""
        total = np.concatenate([[0], np.cumsum(self.counts)])
        ends = np.searchsorted(self.places, self.places + seconds / (1e-9 * self.interval_ns), side="right")
        return int(np.max(total[ends] - total[:-1]))

    def restored(self, imu: ImuSamples) -> ImuSamples:
        """Return the readings with later stamps after lost samples."""
        stamps = self.later(imu.stamps_ns)
        if not self.faster:
            return replace(imu, stamps_ns=stamps)
        shorter = np.round((stamps - stamps[0]) / (1.0 + self.faster)).astype(np.int64)
        late = 1e-9 * self.interval_ns * 12**-0.5  # up to an interval passes until a sample is asked for
        return replace(imu, stamps_ns=stamps[0] + shorter, lateness=math.hypot(imu.lateness, late))

    def warning(self, imu: ImuSamples) -> DataWarning:
        """Return the warning about them."""
        total = int(self.counts.sum())
        if self.faster:
            every, between = 1e-6 * self.interval_ns, 1e-9 * self.interval_ns / self.faster
            text = (
                f"the sensor measures {100.0 * self.faster:.2g} % faster than its readings are asked for, every "
                f"{every:.5g} ms: {total} samples were lost without a gap, one every {between:.3g} s, as the reference "
                "shows; the stamps are now those of its measurements"
            )
            return DataWarning("stamps", text)
        text = (
            f"stamps are counted every {1e-6 * self.interval_ns:.5g} ms, but {total} "
            f"sample{'s were' if total > 1 else ' was'} lost without a gap, at {self.named(imu.seconds)}, as the "
            "reference shows; the stamps after them were corrected"
        )
        return DataWarning("stamps", text)


class LostPoses(_Losses):
    """Poses that were lost without a gap."""

    def restored(self, reference: ReferencePoses) -> ReferencePoses:
        """Return the poses with later stamps after lost ones; those between which a place may lie are doubtful."""
        doubtful, known = self.unsure_poses(reference), reference.doubtful
        return replace(
            reference,
            stamps_ns=self.later(reference.stamps_ns),
            doubtful=doubtful if known is None else doubtful | known,
        )

    def warning(self, reference: ReferencePoses) -> DataWarning:
        """Return the warning about them."""
        total = int(self.counts.sum())
        text = (
            f"stamps of the poses are counted every {1e-6 * self.interval_ns:.5g} ms, but {total} "
            f"pose{'s were' if total > 1 else ' was'} lost without a gap, at {self.named(reference.seconds)}, as the "
            "gyros show; the stamps after them were corrected"
        )
        return DataWarning("stamps", text)


def _moving(reference: ReferencePoses, T: float) -> Mask:
    """Return which poses (n,) are those of a motion that poses show within the time T."""
    tau = reference.seconds
    moving = np.zeros(tau.size, dtype=bool)
    for values, size in ((reference.positions, _LITTLE[0]), (reference.quaternions, _LITTLE[1])):
        if values is not None:
            signs = np.ones((tau.size, 1))
            if values.shape[1] == 4:  # q and -q are the same
                signs[1:, 0] = np.cumprod(np.where(np.sum(values[1:] * values[:-1], axis=1) < 0.0, -1.0, 1.0))
            speed = lengths(np.gradient(values * signs, tau, axis=0))
            moving |= speed * (1.0 if values.shape[1] == 3 else 2.0) * T > size
    return moving


def find_lost_samples(
    imu: ImuSamples, readings: Readings, reference: ReferencePoses, fit: RateFit
) -> LostSamples | None:
    """Return where samples were lost without a gap; None where stamps are not counted, or nothing shows it.

    Notes
    -----
    The difference of the attitudes is d + w e: a slow drift d, and the rate w times the shift e of the clock beside the
    straight line. A lost sample of the interval T changes d by w T and e by -T. The path of e is found by Viterbi's
    algorithm; each of its survivors has its own estimate of d by a Kalman filter, whose covariance is common to all.
    """
    interval = counted_interval(imu.stamps_ns)
    if interval is None or reference.quaternions is None or not _suspicious(fit, 1e-9 * interval):
        return None
    seen, rise = _difference(readings, reference, fit), -fit.clock.skew
    slower = _difference(readings, reference, fit, losses=False)
    path = _with_losses(seen, slower, 1e-9 * interval, rise, turned_on=True)
    if path is None:
        return None
    found, seen = path
    jumps = _survivors(seen, 1e-9 * interval, rise, losses=True, turned_on=False)
    if found.cost > jumps.cost + _ALIKE:  # at rest the two are the same
        return None
    places, counts, unsure = _places(found, seen, 1e-9 * interval)
    if np.median(np.diff(unsure, axis=1)) > _ANYWHERE * (seen.tau[-1] - seen.tau[0]):
        return None
    t = 0.5 * (seen.stamps[places] + seen.stamps[places + 1])
    at = np.clip(np.searchsorted(imu.seconds, t), 1, imu.stamps_ns.size - 1)
    return LostSamples(at.astype(np.int64), counts, interval, unsure)


def find_lost_poses(
    readings: Readings, reference: ReferencePoses, fit: RateFit, skew: float = 0.0
) -> LostPoses | None:  # fmt: skip
    """Return where poses were lost without a gap; None where stamps are not counted, or nothing shows it.

    skew: of the clocks without losses, as far as it is known.

    Notes
    -----
    As `find_lost_samples` with the other sign: a lost pose changes the shift e by +T, and d not at all.
    """
    interval = counted_interval(reference.stamps_ns)
    if interval is None or reference.quaternions is None:
        return None
    T = 1e-9 * interval
    if not _is_uneven(fit, T) and fit.clock.skew < _FASTEST_CRYSTAL + 3.0 * fit.clock.skew_sd:
        return None
    seen = _difference(readings, reference, fit, losses=False)
    rise = fit.clock.skew - skew
    path = _with_losses(replace(seen, rate=-seen.rate), seen, T, rise, turned_on=False)
    if path is None:
        return None
    found, seen = path
    places, counts, unsure = _places(found, seen, T)
    if np.median(np.diff(unsure, axis=1)) > _ANYWHERE * (seen.tau[-1] - seen.tau[0]):
        return None
    middle = 0.5 * (seen.tau[places] + seen.tau[places + 1])
    at = np.clip(np.searchsorted(reference.seconds, middle), 1, reference.stamps_ns.size - 1)
    return LostPoses(at.astype(np.int64), counts, interval, unsure)


def _with_losses(
    seen: _Difference, slower: _Difference, T: float, rise: float, *, turned_on: bool
) -> tuple[_Path, _Difference] | None:
    """Return the path of least cost with losses, and the differences with the noise found; None if there are none.

    slower: differences without losses, which a slower clock must explain less well; of poses, also one that drifts.
    """
    if seen.tau.size < 50 or seen.tau.size * _states(seen, T, rise) > _MAX_WORK:
        return None
    for _ in range(_ROUNDS):
        found = _survivors(seen, T, rise, losses=True, turned_on=turned_on, drifts=turned_on)
        factor = found.noise_factor
        # of poses, the matrix is that of uneven clocks: its errors are no noise, which would hide the losses
        if not turned_on or abs(factor - 1.0) < 0.1:
            break
        seen = replace(seen, noise=factor * seen.noise)
    if found.lost[-1] == found.lost[0]:
        return None
    without = _survivors(replace(slower, noise=seen.noise), T, 0.0, losses=False)
    return None if found.cost > without.cost - _MIN_GAIN else (found, seen)


def _places(found: _Path, seen: _Difference, T: float) -> tuple[Indices, Stamps, Array]:
    """Return the numbers of the differences before places with losses, how many were lost, and where for sure."""
    steps = np.diff(found.lost)
    at = np.flatnonzero(steps > 0)
    return at, steps[at].astype(np.int64), _unsure(seen, T, at)


def _unsure(seen: _Difference, T: float, at: Indices) -> Array:
    """Return first and last reference seconds, (k, 2), between which each place with lost samples lies for sure.

    As long as the rate stays the same, the place makes no difference to the attitudes.
    """
    last, out = seen.tau.size - 1, np.empty((at.size, 2))
    for i, k in enumerate(at):
        shown = np.sum((seen.rate - seen.rate[k]) ** 2, axis=1) * T**2 / seen.noise**2
        before, after = np.cumsum(shown[k::-1]), np.cumsum(shown[k + 1 :])
        low = k - int(np.searchsorted(before, _SURE))
        high = k + 1 + int(np.searchsorted(after, _SURE))
        out[i] = seen.tau[max(low, 0)], seen.tau[min(high, last)]
    return out


def counted_interval(stamps_ns: Stamps) -> int | None:
    """Return the interval of counted stamps, ns, or None."""
    steps = np.diff(stamps_ns)
    usual = float(np.median(steps))
    even = np.abs(steps - usual) < max(_EVEN * usual, 1.5)
    return round(float(np.mean(steps[even]))) if np.mean(even) >= _EVEN_SHARE else None


def _suspicious(fit: RateFit, T: float) -> bool:
    """Return whether the clocks' relation is not one straight line, or not that of equal clocks."""
    return _is_uneven(fit, T) or fit.clock.skew < -3.0 * fit.clock.skew_sd - 1e-6


def _is_uneven(fit: RateFit, T: float) -> bool:
    """Return whether shifts of parts are no straight line, by a share of the interval T."""
    _, shift, sd = fit.clock_drift.T
    known = np.isfinite(shift) & (sd < T)
    off = shift[known] - np.median(shift[known]) if known.any() else np.zeros(0)
    return bool(np.any((np.abs(off) > _UNEVEN * T) & (np.abs(off) > _BEYOND * sd[known])))


@dataclass(frozen=True)
class _Difference:
    """Attitudes by the reference less those by the gyros, along the straight line of the clocks.

    Attributes
    ----------
    tau, stamps : (n,)
        Reference seconds, and IMU seconds on the line.
    angle, rate : (n, 3)
        Difference, rad, and rate, rad/s; along the axes of the reference.
    noise : (n,)
        Deviation of the difference of one pose, rad.
    density
        Noise density of the gyros.
    """

    tau: Array
    stamps: Array
    angle: Array
    rate: Array
    noise: Array
    density: float


def _difference(readings: Readings, reference: ReferencePoses, fit: RateFit, *, losses: bool = True) -> _Difference:
    """Return the difference of the attitudes, by gyros as they are if samples were lost, or if a clock is slower."""
    assert reference.quaternions is not None  # noqa: S101 - for the type checker; the caller checked
    tau = reference.seconds
    t = fit.clock.imu_time(tau)
    every = max(1, round(_STEP / reference.interval))
    inside = np.flatnonzero((t > readings.stamps[4]) & (t < readings.stamps[-5]))[::every]
    tau, t, q = tau[inside], t[inside], reference.quaternions[inside]
    # losses made the preliminary matrix too large: the straight line takes them for a slower clock
    K, b = (x * (1.0 + fit.clock.skew if losses else 1.0) for x in (fit.K_omega, fit.rate_at_zero))
    k = np.clip(np.searchsorted(readings.stamps, t), 1, readings.stamps.size - 1)
    width = max(1, round(0.02 / float(np.median(np.diff(readings.stamps[:1000])))))
    rate = (running_mean(readings.rates, width) if width > 2 else readings.rates)[k] @ K.T + b
    integrated = multiply(attitudes_at(readings, linear_rate(K, b), k), exp(rate * (t - readings.stamps[k])[:, None]))
    start = multiply(q[0], conjugate(integrated[0]))
    predicted = multiply(start, integrated)
    angle = apply(predicted, log(multiply(conjugate(predicted), q)))
    speed = lengths(rate)
    return _Difference(
        tau,
        t,
        angle,
        apply(q, rate),
        np.hypot(fit.residual_sd, reference.lateness * speed),
        float(np.sqrt(np.mean(readings.noise[0]))),
    )


@dataclass(frozen=True)
class _Path:
    """Path of least cost: samples lost before each pose, (n,), and its innovations over their deviations, (n, 3)."""

    cost: float
    lost: Array
    scores: Array

    @property
    def noise_factor(self) -> float:
        """By how much the noise is larger than assumed; that of errors which last longer counts for each pose."""
        size = 1.48 * float(np.median(np.abs(self.scores)))
        inside = np.clip(self.scores, -4.0 * size, 4.0 * size)
        after = float(np.sum(inside[1:] * inside[:-1]) / np.sum(inside**2))
        lasting = np.clip(after, 0.0, 0.9)
        return float(np.clip(size * ((1.0 + lasting) / (1.0 - lasting)) ** 0.5, 0.1, 50.0))


def _states(seen: _Difference, T: float, rise: float) -> int:
    """Return the number of shifts that are tried."""
    return int(np.ceil((2.0 * _FARTHEST + abs(rise) * float(np.ptp(seen.tau))) * _PARTS / T)) + 1


def _survivors(
    seen: _Difference, T: float, rise: float, *, losses: bool, turned_on: bool = True, drifts: bool = True
) -> _Path:  # fmt: skip
    """Return the path of least cost of the shift beside the line, in steps of a part of the interval.

    Parameters
    ----------
    rise
        Of the shift per second, without losses: the line takes lost samples for a slower clock.
    losses
        Whether samples may be lost; if not, the shift stays but for slow changes.
    turned_on
        Whether the IMU turned on while samples were lost. If not, only the clock jumped.
    drifts
        Whether the shift may change slowly, too.
    """
    n, part, states = seen.tau.size, T / _PARTS, _states(seen, T, rise)
    number = np.arange(states)
    mean, P = np.zeros((states, 3)), 0.5**2 * np.eye(3)
    total, came = np.zeros(states), np.zeros((n, states), dtype=np.int16)
    scores = np.zeros((n, states, 3), dtype=np.float32)
    moves = [(0, 0.0, 0), *([(1, _PER_DRIFT, 0), (-1, _PER_DRIFT, 0)] if drifts else [])]
    if losses:
        moves += [(_PARTS * m, _PER_PLACE + _PER_SAMPLE * m, m) for m in range(1, _MAX_AT_ONCE + 1)]
    step = np.diff(seen.tau, prepend=seen.tau[0])
    for i in range(n):
        w = seen.rate[i]
        turned = float(np.linalg.norm(w)) * step[i]
        P = P + np.eye(3) * ((_SCALE_ERROR * turned) ** 2 + (_RATE_ERROR**2 + seen.density**2) * step[i])
        variance = float(P[0, 0]) + seen.noise[i] ** 2
        gain = float(P[0, 0]) / variance
        ahead = _FARTHEST + rise * (seen.tau[i] - seen.tau[0]) - part * number
        measured = seen.angle[i] - ahead[:, None] * w
        best = np.full(states, np.inf)
        chosen, innovation = np.zeros((states, 3)), np.zeros((states, 3))
        for move, price, m in moves[: len(moves) if i else 1]:
            to = slice(max(move, 0), states + min(move, 0))
            since = slice(max(-move, 0), states - max(move, 0))
            before = mean[since] + (m * T if turned_on else 0.0) * w
            left = measured[to] - before
            cost = total[since] + np.minimum(np.einsum("ni,ni->n", left, left) / variance, _CAP) + price
            at = np.flatnonzero(cost < best[to])
            best[to][at], came[i, to][at] = cost[at], move
            chosen[to][at], innovation[to][at] = before[at], left[at]
        scores[i] = innovation / variance**0.5
        length = np.einsum("ni,ni->n", innovation, innovation) / variance
        mean = chosen + gain * innovation * np.minimum(1.0, (_CAP / np.maximum(length, 1e-9)) ** 0.5)[:, None]
        total = best + np.where(np.abs(ahead) > 1.5 * _FARTHEST, 2.0 * _CAP, 0.0)
        P = (1.0 - gain) * P
    state = int(np.argmin(total))
    least = float(total[state])
    lost, taken = np.zeros(n), np.zeros((n, 3))
    count = 0
    for i in range(n - 1, -1, -1):
        lost[i], taken[i] = count, scores[i, state]
        move = int(came[i, state])
        count -= move // _PARTS if move >= _PARTS else 0
        state -= move
    return _Path(least, lost - lost[0], taken)

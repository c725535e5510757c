"""Coarse time relation of two streams by correlation of norms, which do not depend on the mounting.

A first search covers every shift with overlap and clock ratios up to one per cent; then the shift is found
in windows through the recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from kreisel.errors import SynchronizationError
from kreisel.estimation.robust import cauchy_weights
from kreisel.geometry.rotation import Array, Mask, lengths
from kreisel.recording.recording import CHUNK, ImuSamples, ReferencePoses, angles_over, chunks, excerpt
from kreisel.synchronization.clock import MAX_SKEW, Clock
from kreisel.synchronization.fits import Correlation
from kreisel.units import DEG
from kreisel.validation.stamp_checks import runs

MIN_CORRELATION = 0.6
"""Smallest correlation coefficient of two streams of the same motion."""

_COARSE_POINTS = 12000
"""Points of a norm in the first search. Chosen: six minutes at 0.03 s and 50 minutes at 0.25 s, the finest and the
coarsest step; each clock ratio takes Fourier transforms of them."""

_FINE_POINTS = 1_000_000
"""Points of a norm after it. Chosen: 8 MB for an array; ten hours have a step of 36 ms."""

_MAX_SEARCHED = 3600.0
"""s of the reference, around its middle, that the first search takes. Chosen: an hour is enough to find the clocks by;
time and memory of the search increase with the length."""

_SURE = 0.97
"""Coefficient from which no other search follows. Chosen between `MIN_CORRELATION` and 1, that of streams without
noise: a right relation may stay below it where the streams overlap in part, and further searches only take time."""

_SURE_IN_PART = 0.93
"""Coefficient of a part, from which it is accepted. Chosen between `MIN_CORRELATION` and `_SURE`: a short interval fits
fairly well in many places."""

_MIN_IN_COMMON = 0.5
"""Share of the reference that lies within the recording by the stamps, from which they may be of one clock. Chosen."""

_MIN_OVERLAP = 0.25
"""Share of the shorter stream that must overlap, in the search of parts. Chosen: shorter ones fit by chance in many
places."""

_APART = 1.0
"""s; shifts nearer than this are one. Chosen: no programme of a robot is as short."""

_NEARLY, _COARSENESS = 3.0, 0.02
"""Of what a coarse coefficient lacks to 1: the factor, and the addition by the coarse step, with which another shift is
looked at. Chosen: in 30 recordings of motion that does not repeat itself the best other shift lacks 0.2 and more."""

_AS_WELL, _ROUNDED = 2.0, 2e-4
"""The same of the fine coefficient, with which another shift fits as well. Chosen: shifts by periods of a robot's loop
lack as much as the right one, within a tenth; a motion repeated by hand lacks a hundred times as much."""

_MOST_PERIODS = 40
"""Shifts that are looked at."""

_SHORTEST = 0.06
"""s of the average, at least. Chosen: several samples of any IMU."""

_GAP = 0.3
"""s without poses or samples, and several intervals, over which a norm is not known. Chosen: five windows of the
average, 0.06 s; between poses that are farther apart a part of a move is missing."""

_LONGER = 100.0
"""Times the other's duration up to which a recording is searched for it. Chosen: the search takes minutes beyond."""

_BURST = 0.3
"""Of the usual span of a window: poses that follow each other faster have waited, and are stamped late. Chosen: jitter
of stamps shortens a window of several poses by less."""


_IN_MOTION = 20
"""Steps one after the other that are shorter than usual, by which they are no burst. Chosen: packets hold fewer."""


@dataclass(frozen=True)
class _Norm:
    """A norm sampled evenly: value[k] at first + k * step; `known` is false in gaps of the recording."""

    first: float
    step: float
    value: Array
    known: Mask

    @property
    def stamps(self) -> Array:
        return np.asarray(self.first + self.step * np.arange(self.value.size), dtype=np.float64)

    def at(self, t: Array) -> Array:
        """Return the norm between samples, NaN where it is not known."""
        place = (t - self.first) / self.step
        k = np.clip(place.astype(np.int64), 0, self.value.size - 2)
        value = np.asarray(self.value[k] + (place - k) * self._rise[k], dtype=np.float64)
        value[(place < 0.0) | (place > self.value.size - 1.0) | self._gap[k]] = np.nan
        return value

    @cached_property
    def _rise(self) -> Array:
        return np.diff(self.value)

    @cached_property
    def _gap(self) -> Mask:
        return np.asarray(~(self.known[1:] & self.known[:-1]))


def correlate(imu: ImuSamples, reference: ReferencePoses) -> Correlation:
    """Return the clock relation found by correlation of rate norms (of acceleration norms without attitude).

    Raises
    ------
    SynchronizationError
        If the two do not correlate at any shift and ratio; the message names the best coefficient.
    """
    _check_durations(imu, reference)
    fine = max(0.01, 0.5 * reference.interval, float(imu.seconds[-1]) / _FINE_POINTS)
    interval = _interval(reference)
    window = max(_SHORTEST, 2.0 * interval)
    x, y = _norms(imu, reference, fine, interval, window)
    if np.std(y.value) < 1e-3 * (1.0 + np.mean(np.abs(y.value))):
        why = (
            "poses were taken at standstills only, and none in between: clocks cannot be compared. Record poses during "
            "the motion, too"
            if _differ(reference)
            else "the reference does not move, and without motion nothing can be calibrated: record the robot while it "
            "moves"
        )
        raise SynchronizationError(f"{reference.source}: {why}")
    found = _relation(imu, reference, x, y)
    if not found.coefficient >= _SURE and reference.quaternions is not None:
        # the quietest second may be no standstill
        other = _relation(imu, reference, _of_imu(imu, reference, fine, window, at_rest=False), y)
        found = max(found, other, key=lambda one: np.nan_to_num(one.coefficient))
    elif not found.coefficient >= _SURE and window > _SHORTEST:
        # four positions may take as long as a step of a person
        other = _relation(imu, reference, *_norms(imu, reference, fine, interval, 0.5 * window))
        found = max(found, other, key=lambda one: np.nan_to_num(one.coefficient))
    if not found.coefficient >= MIN_CORRELATION:
        raise SynchronizationError(
            f"{reference.source}: the poses do not fit the IMU readings: the best correlation of their rates over all "
            f"shifts and clock ratios is {found.coefficient:.2f}, expected {MIN_CORRELATION} or more. Do both belong "
            "to the same run, do they overlap in time, and did the IMU move?",
            correlation=found.coefficient,
        )
    return found


def _check_durations(imu: ImuSamples, reference: ReferencePoses) -> None:
    """Raise an error where one lasts far longer than the other, and their stamps do not say which part is common."""
    seconds = float(reference.seconds[-1]), float(imu.seconds[-1])
    begin = max(int(imu.stamps_ns[0]), int(reference.stamps_ns[0]))
    common = 1e-9 * (min(int(imu.stamps_ns[-1]), int(reference.stamps_ns[-1])) - begin)
    if max(seconds) > _LONGER * min(seconds) and common < 0.5 * min(seconds):
        raise SynchronizationError(
            f"{reference.source}: the poses last {seconds[0]:.4g} s, the readings {seconds[1]:.4g} s, and by their "
            "stamps they do not fit each other: correct the unit of the stamps, or cut the longer one to the run"
        )


def _relation(imu: ImuSamples, reference: ReferencePoses, x: _Norm, y: _Norm) -> Correlation:
    """Return the clock relation by which two norms correlate best."""
    found = _as_stamped(imu, reference, x, y)
    if found is None:
        clock, coefficient = _related(x, y)
        found = Correlation(clock, coefficient, _periods(x, y, clock, coefficient))
    return found


def _as_stamped(imu: ImuSamples, reference: ReferencePoses, x: _Norm, y: _Norm) -> Correlation | None:
    """Return the clock relation near that of stamps of one clock; None if they are of two.

    A motion that repeats itself correlates as well at every period, and the stamps say which one is right.
    """
    same = Clock(1e-9 * float(int(reference.stamps_ns[0]) - int(imu.stamps_ns[0])))
    common = float(np.mean(np.isfinite(x.at(same.imu_time(y.stamps)))))
    if common < _MIN_IN_COMMON or not _coefficient(x, y, same) >= _SURE_IN_PART:
        return None
    clock = _track(x, y, same)
    final = _coefficient(x, y, clock)
    return Correlation(clock, final) if final >= _SURE else None


def correlate_imus(imu: ImuSamples, other: ImuSamples) -> Correlation:
    """Return the clock relation of two IMUs on one body, found by correlation of their rates' norms.

    tau of the clock counts the seconds of `other`. Stamps of one clock need no search. The coefficient is that of what
    was found, however small; NaN where one of them does not move.
    """
    step = max(0.01, 0.5 * max(imu.interval, other.interval), float(imu.seconds[-1]) / _FINE_POINTS)
    window = max(_SHORTEST, 2.0 * max(imu.interval, other.interval))
    x, y = (
        _even_norm(one.seconds, one.rates, np.median(one.rates[quietest_second(one)], axis=0), 0.0, step, window)
        for one in (imu, other)
    )
    if min(np.std(x.value), np.std(y.value)) == 0.0:
        return Correlation(Clock(0.0), float("nan"))
    same = Clock(1e-9 * float(int(other.stamps_ns[0]) - int(imu.stamps_ns[0])))
    if _coefficient(x, y, same) >= _SURE_IN_PART:
        clock = _track(x, y, same)
        return Correlation(clock, _coefficient(x, y, clock))
    return Correlation(*_related(x, y))


def _related(x: _Norm, y: _Norm) -> tuple[Clock, float]:
    """Return the clock relation by which two norms correlate best, and their coefficient."""
    clock = _track(x, y, _search(x, y, usual=True))
    final = _coefficient(x, y, clock)
    if final >= _SURE:
        return clock, final
    clock = _track(x, y, _search(x, y))
    final = _coefficient(x, y, clock)
    if not final >= _SURE:
        part = _track(x, y, _search_part(x, y))
        better = _coefficient(x, y, part)
        # a short interval fits fairly well in many places
        if better >= _SURE_IN_PART and not final >= better:
            return part, better
    return clock, final


def _differ(reference: ReferencePoses) -> bool:
    """Return whether poses lie apart, by a degree or a centimetre."""
    p, q = reference.positions, reference.quaternions
    turned = q is not None and float(np.abs(q @ q[0]).min()) < np.cos(0.5 * DEG)
    return turned or (p is not None and float(np.ptp(p, axis=0).max()) > 0.01)


def _norms(
    imu: ImuSamples, reference: ReferencePoses, step: float, interval: float, window: float
) -> tuple[_Norm, _Norm]:
    """Return the norms of IMU and reference, each on an even grid and smoothed in the same way.

    interval, window: between poses in motion, and that of the average, s.
    """
    moved = _turning if reference.quaternions is not None else _accelerating
    tau, norm = moved(reference, window, interval)
    if tau.size < 2:
        raise SynchronizationError(
            f"{reference.source}: the stamps of the poses come in bursts, as times of arrival do: record those of the "
            "device that measures the poses"
        )
    return _of_imu(imu, reference, step, window), _even(tau, norm, step, 0.0)


def _interval(reference: ReferencePoses) -> float:
    """Return the usual interval between poses, s; that in motion, where most are recorded less often at rest."""
    steps = np.diff(reference.seconds)
    short = steps < _BURST * reference.interval
    begin, end = runs(short)
    return float(np.median(steps[short])) if begin.size and np.median(end - begin) > _IN_MOTION else reference.interval


def _of_imu(
    imu: ImuSamples, reference: ReferencePoses, step: float, window: float, *, at_rest: bool = True
) -> _Norm:  # fmt: skip
    """Return the norm of the readings that compares with a reference, on an even grid.

    at_rest: whether the quietest second shows the gyros' offsets, which are taken for zero otherwise.
    """
    if reference.quaternions is not None:
        bias = np.median(imu.rates[quietest_second(imu)], axis=0) if at_rest else np.zeros(3)
        return _even_norm(imu.seconds, imu.rates, bias, 0.0, step, window)
    usual = float(np.median([np.median(lengths(part)) for part in excerpt(imu.accelerations)]))
    return _even_norm(imu.seconds, imu.accelerations, np.zeros(3), usual, step, 2.0 * window)


def _turning(reference: ReferencePoses, window: float, interval: float) -> tuple[Array, Array]:
    """Return the reference's rate norm over a window, rad/s, and the middles of the windows."""
    q, tau = reference.quaternions, reference.seconds
    assert q is not None  # noqa: S101 - for the type checker; the caller checked
    stride = max(1, round(window / interval))
    span = tau[stride:] - tau[:-stride]
    usual = stride * interval
    near = (span < max(3.0 * usual, _GAP)) & (span > _BURST * usual)
    return (0.5 * (tau[stride:] + tau[:-stride]))[near], (angles_over(q, stride) / span)[near]


def _accelerating(reference: ReferencePoses, window: float, interval: float) -> tuple[Array, Array]:
    """Return the times, and by how much the norm of the reference's specific force differs from gravity, m/s^2."""
    p, tau = reference.positions, reference.seconds
    assert p is not None  # noqa: S101 - a reference has one of the two
    stride = max(1, round(2.0 * window / interval))
    span = tau[stride:] - tau[:-stride]
    speed = (p[stride:] - p[:-stride]) / span[:, None]
    accel = 2.0 * (speed[stride:] - speed[:-stride]) / (span[stride:] + span[:-stride])[:, None]
    # up is assumed along the reference's z; a tilt changes little in a norm dominated by gravity
    moved = np.abs(lengths(accel + np.array([0.0, 0.0, 9.8])) - 9.8)
    apart = np.minimum(span[stride:], span[:-stride]) > _BURST * stride * interval
    return tau[stride:-stride][apart], moved[apart]


def quietest_second(imu: ImuSamples) -> slice:
    """Return the second of the recording with the smallest variance of the rates: most likely a standstill."""
    n = max(8, round(1.0 / imu.interval))
    blocks = imu.rates[: imu.rates.shape[0] // n * n].reshape(-1, n, 3)
    some = max(1, CHUNK // n)
    spread = [blocks[k : k + some].var(axis=1).sum(axis=1) for k in range(0, len(blocks), some)]
    best = int(np.argmin(np.concatenate(spread)))
    return slice(best * n, (best + 1) * n)


def _even_norm(t: Array, values: Array, centre: Array, usual: float, step: float, window: float) -> _Norm:
    """Return | |values - centre| - usual | averaged over `window`, on an even grid, computed in chunks."""
    parts: list[_Norm] = []
    grid, half = _grid(t, step), 0.5 * max(window, step)
    for part in chunks(t.size):
        within = slice(*np.searchsorted(grid, (t[part][0], t[part.stop] if part.stop < t.size else np.inf)))
        if within.stop == within.start:
            continue
        low, high = np.searchsorted(t, (grid[within.start] - half, grid[within.stop - 1] + half))
        wide = slice(max(int(low) - 1, 0), int(high) + 2)
        norm = np.abs(lengths(values[wide] - centre) - usual)
        parts.append(_averaged(t[wide], norm, grid[within], step, half))
    value, known = (np.concatenate([getattr(part, name) for part in parts]) for name in ("value", "known"))
    return _Norm(float(grid[0]), step, value, known)


def _even(t: Array, value: Array, step: float, window: float) -> _Norm:
    """Average over `window` on an even grid."""
    return _averaged(t, value, _grid(t, step), step, 0.5 * max(window, step))


def _grid(t: Array, step: float) -> Array:
    return np.arange(t[0], t[-1], step)


def _averaged(t: Array, value: Array, grid: Array, step: float, half: float) -> _Norm:
    """Average over `half` to either side by differences of the running integral."""
    dt = np.diff(t)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * dt)])
    low, high = np.clip(grid - half, t[0], t[-1]), np.clip(grid + half, t[0], t[-1])
    mean = (np.interp(high, t, integral) - np.interp(low, t, integral)) / np.maximum(high - low, 1e-9)
    known = np.ones(grid.size, dtype=bool)
    for k in np.flatnonzero(dt > max(_GAP, 5.0 * float(np.median(dt)))):
        known[(grid > t[k]) & (grid < t[k + 1])] = False
    return _Norm(float(grid[0]), step, mean, known)


def _search(x: _Norm, y: _Norm, *, usual: bool = False) -> Clock:
    """Search all shifts and ratios. Long recordings are searched on a coarser grid, in the hour around their middle.

    usual: whether clocks are searched that run alike, as most do, and no others.
    """
    spare = max(0, y.value.size - round(_MAX_SEARCHED / y.step)) // 2
    middle = slice(spare, y.value.size - spare)
    xc, yc = _coarse(x, _Norm(y.first + spare * y.step, y.step, y.value[middle], y.known[middle]))
    xv = xc.value - xc.value.mean()
    best = (-1.0, 0.0, 0.0)
    transformed: dict[int, Any] = {}
    for skew, yv, _ in [(0.0, yc.value, yc.known)] if usual else _rescaled(yc):
        centred = yv - yv.mean()
        size = 2 ** int(np.ceil(np.log2(xv.size + yv.size)))
        if size not in transformed:
            transformed[size] = np.fft.rfft(xv, size)
        product = np.fft.irfft(transformed[size] * np.conj(np.fft.rfft(centred, size)), size)
        k = int(np.argmax(product))
        value = float(product[k]) / max(float(np.linalg.norm(xv) * np.linalg.norm(centred)), 1e-30)
        if value > best[0]:
            best = (value, skew, (k if k < xv.size else k - size) * xc.step)
    _, skew, lag = best
    return Clock(xc.first + lag - (1.0 + skew) * yc.first, skew)


def _search_part(x: _Norm, y: _Norm) -> Clock:
    """Search as `_search` does, but compare only the overlap: one stream may begin or end much earlier."""
    xc, yc = _coarse(x, y)
    best = (-1.0, 0.0, 0.0)
    for skew, yv, known_y in _rescaled(yc):
        value, lags = _over_shifts(xc, yv, known_y)
        k = int(np.argmax(value))
        if value[k] > best[0]:
            best = (float(value[k]), skew, float(lags[k]))
    _, skew, lag = best
    return Clock(xc.first + lag - (1.0 + skew) * yc.first, skew)


def _over_shifts(x: _Norm, y: Array, known_y: Array) -> tuple[Array, Array]:
    """Return the coefficients of two norms over what they have in common, for every shift, and the shifts, s.

    Zero where that is too short, or one of them hardly changes: a standstill fits any other.
    """
    known_x = x.known.astype(float)
    size = 2 ** int(np.ceil(np.log2(x.value.size + y.size)))
    u, v = known_x * (x.value - x.value.mean()), known_y * (y - y.mean())
    of_x = [np.fft.rfft(part, size) for part in (known_x, u, u**2)]
    of_y = [np.conj(np.fft.rfft(part, size)) for part in (known_y, v, v**2)]
    # sums over the overlap, for every shift: count, x, y, x^2, y^2, x y
    count, sum_x, sum_y, square_x, square_y, product = (
        np.fft.irfft(of_x[a] * of_y[b], size) for a, b in ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1))
    )
    n = np.maximum(np.round(count), 1.0)
    spread_x, spread_y = square_x - sum_x**2 / n, square_y - sum_y**2 / n
    enough = (n >= _MIN_OVERLAP * min(u.size, v.size)) & (
        (spread_x > 0.1 * n * float(np.var(u))) & (spread_y > 0.1 * n * float(np.var(v)))
    )
    value = np.where(enough, product - sum_x * sum_y / n, 0.0) / np.sqrt(np.where(enough, spread_x * spread_y, 1.0))
    before = size - u.size  # shifts below zero stand at the end
    return np.roll(value, before), x.step * np.arange(-before, u.size)


def _periods(x: _Norm, y: _Norm, clock: Clock, coefficient: float) -> tuple[float, ...]:
    """Return the shifts of a clock, s, by which two norms correlate as well as by the clock itself."""
    if not coefficient >= MIN_CORRELATION:
        return ()
    xc, yc = _coarse(x, y)
    value, lags = _over_shifts(xc, *_at_ratio(yc, clock.skew))
    shifts = lags + xc.first - (1.0 + clock.skew) * yc.first - clock.start
    here = float(value[int(np.argmin(np.abs(shifts)))])
    peaks = np.r_[False, (value[1:-1] >= value[:-2]) & (value[1:-1] > value[2:]), False]
    peaks &= (np.abs(shifts) > _APART) & (1.0 - value < _NEARLY * (1.0 - here) + _COARSENESS)
    found = []
    for shift in sorted(shifts[peaks], key=abs)[:_MOST_PERIODS]:
        other = _track(x, y, replace(clock, start=clock.start + float(shift)))
        away = other.start - clock.start
        if abs(away) > _APART and 1.0 - _coefficient(x, y, other) < _AS_WELL * (1.0 - coefficient) + _ROUNDED:
            found.append(away)
    return tuple(found)


def _coarse(x: _Norm, y: _Norm) -> tuple[_Norm, _Norm]:
    longest = max(x.value.size * x.step, y.value.size * y.step)
    step = min(max(x.step, 0.03, longest / _COARSE_POINTS), 0.25)
    return _coarser(x, step), _coarser(y, step)


def _coarser(x: _Norm, step: float) -> _Norm:
    even = _even(x.stamps, x.value, step, 2.0 * step)
    return replace(even, known=np.interp(even.stamps, x.stamps, x.known.astype(float)) > 0.999)


def _rescaled(y: _Norm) -> Iterator[tuple[float, Array, Array]]:
    """Yield every clock ratio less one, y on the other clock, and 1 where it is known."""
    ratio_step = min(4.0 / y.value.size, MAX_SKEW / 4.0)
    half = int(np.ceil(MAX_SKEW / ratio_step))
    for skew in ratio_step * np.arange(-half, half + 1):
        yield float(skew), *_at_ratio(y, float(skew))


def _at_ratio(y: _Norm, skew: float) -> tuple[Array, Array]:
    """Return y on a clock that runs faster by a share, and 1 where it is known."""
    tau = np.arange(0.0, y.value.size * y.step * (1.0 + skew) - y.step, y.step) / (1.0 + skew)
    at = y.stamps - y.first
    return np.interp(tau, at, y.value), np.interp(tau, at, y.known.astype(float))


def _track(x: _Norm, y: _Norm, clock: Clock) -> Clock:
    """Find the shift in windows from the middle outwards and fit a line to the shifts."""
    duration = y.value.size * y.step
    width = float(np.clip(duration / 8.0, 8.0, 30.0))
    starts = np.arange(y.first, y.first + max(duration - width, 0.0) + 1e-9, max(width / 2.0, duration / 200.0))
    if starts.size < 3:
        return _polish(x, y, clock)
    order = np.argsort(np.abs(starts - starts.mean()))
    centres: list[float] = []
    shifts: list[float] = []
    weights: list[float] = []
    reach = max(0.3, 0.5 * MAX_SKEW * width)
    for i in order:
        tau = np.arange(starts[i], starts[i] + width, y.step)
        guess = clock
        if len(centres) >= 4:
            guess = _line(clock, np.array(centres), np.array(shifts), np.array(weights))
        found = _local_shift(x, y, guess, tau, reach)
        if found is None:
            continue
        shift, coefficient = found
        if coefficient > 0.7:
            centres.append(float(tau.mean()))
            shifts.append(shift + float(guess.imu_time(tau.mean()) - clock.imu_time(tau.mean())))
            weights.append(coefficient)
    if len(centres) < 3:
        return _polish(x, y, clock)
    return _line(clock, np.array(centres), np.array(shifts), np.array(weights))


def _line(clock: Clock, centres: Array, shifts: Array, weights: Array) -> Clock:
    """Fit shift = a + b tau robustly and return the corrected clock."""
    w = weights.copy()
    pivot = float(centres.mean())
    for _ in range(10):
        share = w**2 / float(w @ w)
        centre, mean = float(share @ centres), float(share @ shifts)
        apart = share * (centres - centre)
        slope = float(apart @ shifts) / max(float(apart @ centres), 1e-300)
        mean += slope * (pivot - centre)
        residual = np.abs(shifts - mean - slope * (centres - pivot))
        sd = 1.5 * _median(residual) + 1e-3
        w = weights * cauchy_weights(residual, 2.0 * sd)
    spread = float(np.std(centres)) + 1e-9
    count = np.sqrt(centres.size)
    return Clock(
        clock.start + mean - slope * pivot,
        clock.skew + slope,
        sd / count + pivot * sd / (spread * count),
        sd / (spread * count),
    )


def _median(values: Array) -> float:
    """Return the median of few values (n,), for which `np.median` takes far longer than sorting."""
    ordered, half = np.sort(values), values.size // 2
    return float(0.5 * (ordered[half] + ordered[~half]))


def _polish(x: _Norm, y: _Norm, clock: Clock) -> Clock:
    overlap = np.flatnonzero(np.isfinite(x.at(clock.imu_time(y.stamps))))
    found = _local_shift(x, y, clock, y.stamps[overlap[0] : overlap[-1] + 1], 0.5) if overlap.size else None
    return clock if found is None else Clock(clock.start + found[0], clock.skew, 0.01, 0.0)


def _local_shift(x: _Norm, y: _Norm, clock: Clock, tau: Array, reach: float) -> tuple[float, float] | None:
    """Return the shift near a guess that fits a window best, and the coefficient there.

    tau (m,): evenly spaced by the norms' step; shifts are multiples of that step on the IMU's clock.
    """
    yv = y.at(tau)
    if yv.size < 2 or not np.isfinite(yv).all() or np.std(yv) < 1e-2:
        return None
    step = float(tau[-1] - tau[0]) / (tau.size - 1)
    most = round(reach / step)
    wide = tau[0] + step * np.arange(-most, tau.size + most)
    scores = _sliding_pearson(x.at(clock.imu_time(wide)), yv)
    shifts = (1.0 + clock.skew) * step * np.arange(-most, most + 1)
    if not np.isfinite(scores).any():
        return None
    k = int(np.nanargmax(scores))
    if 0 < k < shifts.size - 1 and np.isfinite(scores[k - 1 : k + 2]).all():
        a, b, c = scores[k - 1 : k + 2]
        bend = a - 2.0 * b + c
        return float(shifts[k] + (0.5 * (a - c) / bend * (shifts[1] - shifts[0]) if bend < 0.0 else 0.0)), float(b)
    return float(shifts[k]), float(scores[k])


def _sliding_pearson(x: Array, y: Array) -> Array:
    """Return the coefficients of y (m,) with x[k : k + m] for every k, over what is known of x (not NaN)."""
    known = np.isfinite(x)
    u, v = np.where(known, x - np.mean(x[known]) if known.any() else 0.0, 0.0), y - y.mean()
    m = known.astype(float)
    ones = np.ones_like(v)
    count, sum_x, square_x = (np.correlate(part, ones, "valid") for part in (m, u, u**2))
    sum_y, square_y, product = (np.correlate(a, b, "valid") for a, b in ((m, v), (m, v**2), (u, v)))
    n = np.maximum(count, 1.0)
    size = np.sqrt(np.maximum(square_x - sum_x**2 / n, 0.0) * np.maximum(square_y - sum_y**2 / n, 0.0))
    enough = (count >= 0.6 * y.size) & (size > 0.0)
    return np.asarray(np.where(enough, (product - sum_x * sum_y / n) / np.where(enough, size, 1.0), np.nan))


def _pearson(a: Array, b: Array) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 0.6 * b.size:
        return float("nan")
    u, v = a[both] - a[both].mean(), b[both] - b[both].mean()
    size = float(np.linalg.norm(u) * np.linalg.norm(v))
    return float(u @ v) / size if size > 0.0 else float("nan")


def _coefficient(x: _Norm, y: _Norm, clock: Clock) -> float:
    of_reference, value = y.at(y.stamps), x.at(clock.imu_time(y.stamps))
    both = np.isfinite(value) & np.isfinite(of_reference)
    if both.sum() * y.step < 4.0:
        return float("nan")
    return _pearson(value[both], of_reference[both])

"""Regular sampling restored from irregular stamps, for example where a computer stamps an IMU's samples late.

A sensor with its own timer samples evenly; the stamps in the file scatter, are late, or come in bursts.
A straight line through the stamps of each segment is then nearer to the moments of sampling than any single
stamp. Where the readings show that the samples were taken when the stamps say, nothing is changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kreisel.errors import RecordingError
from kreisel.estimation.robust import cauchy_weights
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, ImuSamples, ReferencePoses, Stamps
from kreisel.validation.stamp_checks import runs

EXACT = 2e-3
"""Scatter of the stamps, in sampling intervals, below which they are not changed."""

MIN_PART = 100
"""Samples needed to fit a line."""

_BREAK = 0.05
"""Seconds (and five intervals) without samples that end a segment."""

_BLOCK = 2.0
"""Seconds over which stamps are averaged to check whether they follow a straight line."""

_ONE_MISSING = 0.6
"""Intervals by which the earliest stamps after a place are later than those before it where a sample is missing.
Chosen: just above the half."""

_STRAIGHT = 2e-4
"""s; by how much these averages may deviate from a straight line, besides their scatter."""

_COARSE_NS = 50_000
"""ns; stamps rounded more finely than this are exact."""

_MAX_SEARCHED = 2_000_000
"""Samples of a segment in which missing ones are looked for among late stamps. Chosen: 83 minutes at 400 Hz; each
missing sample takes a further look at all of them."""

_MAX_RESTARTS, _MIN_PART_NS = 3, 8_000_000_000
"""Places at which a clock may be set, and the least length of the parts between them."""

_SET_BACK, _SET_NS, _FAR_NS = 100.0, 600e9, 4e18
"""Steps back, in usual steps, and steps forward, ns, by which a clock was set; differences that would overflow."""

_SHORT, _ASKED, _GAP, _WITHIN, _LONGER = 10.0, 0.1, 4.5, 1.3, 8
"""Steps of stamps of a sensor that is asked more often than it measures: percentile that is a usual one; scatter, and
length of a gap, in usual steps; range of the stamps beside a line, in steps (1 without scatter); and number of longer
steps. Chosen: of eight steps at random places, one in 20 000 draws lies so evenly."""

_BURST, _BURSTS, _MOST_AT_ONCE = 0.3, 0.1, 20
"""Of the mean step, up to which poses come at once; times that they do, as a share of the poses at least; and as many
steps at once at most. Chosen: packets hold a few poses, and a robot that records more often in motion hundreds."""

_OFF_LINE = 0.3
"""Intervals by which the mean of bursts over seconds may depart from a line. Chosen: a pose that is missing moves it by
a half on either side."""

_LAG = 16  # samples over which the interval is measured: few enough that usually none of them is missing
_TRUE_STAMPS = 0.5
"""Slope of the readings' deviations against those that true stamps would cause: 1 if stamps are true, 0 if sampling is
regular. Chosen: the middle."""

_SURE, _SCATTER = 5.0, 0.4
"""Deviations by which that slope of poses must be smaller, where they cannot tell their stamps stay; and scatter of
stamps about a line, in intervals, beyond which it is not known which pose is which."""


@dataclass(frozen=True)
class _Line:
    """Numbers (n,) of the samples of a segment, first and interval of the line through their stamps, s."""

    number: Stamps
    first: float
    interval: float

    @property
    def stamps(self) -> Array:
        """Moments of sampling, (n,), s."""
        return np.asarray(self.first + self.interval * self.number, dtype=np.float64)


def with_restarts(imu: ImuSamples, *, moved: bool) -> ImuSamples:
    """Return the samples with ascending stamps where the clock was set a few times, as by a device that restarts.

    The parts follow each other a second apart; where they really belong, the reference shows.

    Parameters
    ----------
    moved
        Whether there is a reference. Without one nothing is changed.
    """
    stamps = imu.stamps_ns
    if stamps.size < MIN_PART or not moved or np.abs(stamps - np.median(stamps)).max() > _FAR_NS:
        return imu
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    places = np.flatnonzero((steps < -_SET_BACK * usual) | (steps > max(_SET_NS, 1e4 * usual))) + 1
    edges = np.array([0, *places.tolist(), stamps.size])
    lengths = np.array([stamps[b - 1] - stamps[a] for a, b in pairwise(edges.tolist())])
    if not places.size or places.size > _MAX_RESTARTS or lengths.min() < _MIN_PART_NS:
        return imu
    moved_by = np.zeros(stamps.size, dtype=np.int64)
    moved_by[places] = 1_000_000_000 - steps[places - 1]
    ascending = stamps + np.cumsum(moved_by)
    return replace(imu, stamps_ns=ascending, restarts_ns=ascending[places])


def regularly_sampled(imu: ImuSamples, *, repeats: bool = False) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with stamps of regular sampling, if they were sampled regularly, and the warnings about it.

    repeats: whether samples that only repeat the one before were left out. A sensor was then asked more often than it
    measures, and no sample is missing where the steps of the stamps are twice as long.
    """
    stamps = imu.stamps_ns
    if stamps.size < MIN_PART:
        return imu, []
    seconds = (stamps - stamps[0]) * 1e-9
    if not np.isfinite(seconds).all() or _repeated_rows(imu):
        return imu, []
    if (polled := _polled(seconds)) is not None:
        return _on_lines(imu, polled, certain=repeats)
    if _even(seconds):
        return imu, []
    mean = float(seconds[-1] / (seconds.size - 1))
    if not 5e-5 < mean < 0.05:
        return imu, []
    steps = np.diff(seconds)
    # samples that arrive late, or many at once, come with long steps between them again and again
    longest = max(_BREAK, 5.0 * mean, 1.5 * float(np.percentile(steps, 99.9)))
    lines = _through_all(seconds, longest) or _of_parts(seconds, longest, _fitted)
    return (imu, []) if lines is None else _on_lines(imu, lines)


def _through_all(seconds: Array, longest: float) -> list[tuple[slice, _Line]] | None:
    """Return one line through all stamps where none is missing at the long steps: a queue that was held up.

    The stamps after such a step are late, and return to the line of those before it; after missing samples they do not.
    """
    steps = np.flatnonzero(np.diff(seconds) > longest) + 1
    if not steps.size:
        return None
    line = _robust_line(seconds, np.arange(seconds.size), float(seconds[-1]) / (seconds.size - 1))
    left = seconds - line.stamps
    window, most = round(_BLOCK / line.interval), _ONE_MISSING * line.interval
    returned = all(left[k : k + window].min() - left[max(k - window, 0) : k].min() < most for k in steps.tolist())
    return [(slice(0, seconds.size), line)] if returned and _straight(left, line.interval) else None


def _of_parts(
    seconds: Array, longest: float, line_of: Callable[[Array], _Line | None]
) -> list[tuple[slice, _Line]] | None:
    """Return the line of each part between steps longer than `longest`; None if a part is short or has none."""
    edges = [0, *(np.flatnonzero(np.diff(seconds) > longest) + 1).tolist(), seconds.size]
    lines = []
    for begin, end in pairwise(edges):
        line = line_of(seconds[begin:end]) if end - begin >= MIN_PART else None
        if line is None:
            return None
        lines.append((slice(begin, end), line))
    return lines


def _on_lines(
    imu: ImuSamples, lines: list[tuple[slice, _Line]], *, certain: bool = False
) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with the stamps of lines, if the readings do not contradict, and the warnings about it.

    certain: whether it is known that the samples were taken evenly.
    """
    stamps = imu.stamps_ns
    seconds = (stamps - stamps[0]) * 1e-9
    late = np.concatenate([seconds[part] - line.stamps for part, line in lines])
    interval = float(np.median([line.interval for _, line in lines]))
    if _spread(late) < EXACT * interval:
        return imu, []
    if not certain and _share_of_stamps(imu.rates, seconds, lines)[0] > _TRUE_STAMPS:
        return imu, []
    moved = np.concatenate([line.stamps for _, line in lines])
    ns = stamps[0] + np.round(moved * 1e9).astype(np.int64)
    if np.any(np.diff(ns) <= 0):
        return imu, []
    lost = sum(int(line.number[-1]) + 1 - line.number.size for _, line in lines)
    # the stamps do not show on which side of the line the moments of sampling are, nor how far away
    return replace(imu, stamps_ns=ns, lateness=float(np.std(late))), [_warning(imu, interval, late, lost)]


def evenly_stamped(poses: ReferencePoses, *, by_arm: bool = False) -> tuple[ReferencePoses, list[DataWarning]]:
    """Return poses that come in bursts, or late by chance, with stamps of regular sampling, and the warning about it.

    by_arm: whether the controller of an arm stamps them, which is not late by chance.

    Raises
    ------
    RecordingError
        If they come in bursts, and were not sampled regularly.
    """
    seconds = (poses.stamps_ns - poses.stamps_ns[0]) * 1e-9
    steps = np.diff(seconds)
    near = steps[steps < 1.0]
    mean = float(near.mean()) if near.size else 0.0
    if poses.stamps_ns.size < MIN_PART:
        return poses, []
    longest = max(_BREAK, 5.0 * mean, 1.5 * float(np.percentile(steps, 99.9)))
    begin, end = runs(steps < _BURST * mean)
    if begin.size < _BURSTS * steps.size or np.median(end - begin) > _MOST_AT_ONCE:
        return (poses, []) if by_arm else _late_by_chance(poses, seconds, longest)
    lines = _of_parts(seconds, longest, _through_bursts) or _of_parts(seconds, longest, _fitted)
    found = None if lines is None else _on_pose_lines(poses, lines, "come in bursts")
    if found is None:
        raise RecordingError(
            f"poses come in bursts: the usual step of their stamps is {1e3 * float(np.median(steps)):.3g} ms, the mean "
            f"{1e3 * mean:.3g} ms. These are times of arrival; record the stamps of the device that measures the poses",
            file=poses.source,
        )
    return found


def _late_by_chance(poses: ReferencePoses, seconds: Array, longest: float) -> tuple[ReferencePoses, list[DataWarning]]:
    """Return poses with stamps of regular sampling where they show that their own, of arrival, are late by chance."""
    if _even(seconds) or poses.positions is None or np.any(np.diff(seconds) <= 0.0):
        return poses, []
    if (lines := _of_parts(seconds, longest, _fitted)) is None:
        return poses, []
    found = _on_pose_lines(poses, lines, "arrive late by chance")
    if found is None or found[0].lateness > _SCATTER * min(line.interval for _, line in lines):
        return poses, []
    share, sd = _share_of_stamps(poses.positions, seconds, lines)
    return (poses, []) if share + _SURE * sd > _TRUE_STAMPS else found


def _on_pose_lines(
    poses: ReferencePoses, lines: list[tuple[slice, _Line]], how: str
) -> tuple[ReferencePoses, list[DataWarning]] | None:
    """Return poses with the stamps of lines, and the warning about it; None where these do not ascend."""
    seconds = (poses.stamps_ns - poses.stamps_ns[0]) * 1e-9
    moved = np.concatenate([line.stamps for _, line in lines])
    ns = poses.stamps_ns[0] + np.round(moved * 1e9).astype(np.int64)
    if np.any(np.diff(ns) <= 0):
        return None
    late = float(np.std(moved - seconds))
    interval = float(np.median([line.interval for _, line in lines]))
    text = (
        f"{poses.source.parent.name}: poses every {1e3 * interval:.5g} ms {how}; their stamps scatter about "
        f"that by {1e3 * late:.2g} ms, and a straight line through them is used instead"
    )
    return replace(poses, stamps_ns=ns, lateness=late), [DataWarning("stamps", text)]


def with_lateness(poses: ReferencePoses) -> tuple[ReferencePoses, list[DataWarning]]:
    """Return poses with the lateness that comes from rounded stamps, if they are rounded, and the warning about it.

    Few poses are used, at even times: all may be rounded in the same direction.
    """
    stamps = poses.stamps_ns
    if stamps.size < MIN_PART:
        return poses, []
    step = int(np.gcd.reduce(np.diff(stamps)))
    seconds, number = (stamps - stamps[0]) * 1e-9, np.arange(stamps.size)
    late = seconds - np.polyval(np.polyfit(number, seconds, 1), number)
    rounding = float(np.std(late))
    if step < _COARSE_NS or rounding < 0.05e-9 * step or np.abs(late).max() > 0.6e-9 * step:
        return poses, []
    text = (
        f"{poses.source.parent.name}: stamps are rounded to {1e-6 * step:.4g} ms; the standard deviation of the time "
        f"offset includes {1e3 * rounding:.2g} ms because of that"
    )
    return replace(poses, lateness=rounding), [DataWarning("stamps", text)]


def _warning(imu: ImuSamples, interval: float, late: Array, lost: int) -> DataWarning:
    """Return the warning about stamps that were replaced."""
    largest = float(late[np.argmax(np.abs(late))])
    text = (
        f"{imu.source.parent.name}: sampled every {1e3 * interval:.5g} ms; stamps scatter about that by "
        f"{1e3 * float(np.std(late)):.2g} ms (up to {1e3 * abs(largest):.2g} ms {'late' if largest > 0 else 'early'})"
    )
    if lost:
        text += f", {lost} sample{'s are' if lost > 1 else ' is'} missing"
    return DataWarning("stamps", f"{text}; a straight line through them is used instead")


def _even(seconds: Array) -> bool:
    """Return whether stamps are even except at missing samples."""
    steps = np.diff(seconds)
    usual = float(np.median(steps))
    if usual <= 0.0:
        return False
    whole = np.maximum(np.round(steps / usual), 1.0)
    return bool(np.mean(whole) < 2.0 and np.abs(steps - whole * usual).max() < EXACT * usual)


def _polled(seconds: Array) -> list[tuple[slice, _Line]] | None:
    """Return the lines through stamps of a sensor that is asked more often than it measures, or None.

    Its stamps are those of the asking, and some steps are longer than others, so evenly that the stamps stay within one
    step of the asking beside a line; where samples are lost at random, they depart from it by more, the longer.
    """
    steps = np.diff(seconds)
    short = float(np.percentile(steps, _SHORT))
    if short <= 0.0:
        return None
    asked = float(np.median(steps[steps < 1.5 * short]))
    if np.abs(steps - np.round(steps / asked) * asked).max() > _ASKED * asked:
        return None

    def line_of(t: Array) -> _Line | None:
        number = np.arange(t.size)
        slope, first = np.polyfit(number, t, 1)
        beside = float(np.ptp(t - first - slope * number))
        return None if beside > _WITHIN * asked else _Line(number, float(first), float(slope))

    longer = np.count_nonzero((steps > 1.5 * asked) & (steps <= _GAP * asked))
    return _of_parts(seconds, _GAP * asked, line_of) if longer >= _LONGER else None


def _repeated_rows(imu: ImuSamples) -> bool:
    """Return whether a stamp occurs twice with the same readings: a row that was written twice."""
    same = np.flatnonzero(np.diff(imu.stamps_ns) == 0)
    return bool(same.size and (imu.rates[same + 1] == imu.rates[same]).all(axis=1).any())


def _through_bursts(t: Array) -> _Line | None:
    """Return the line through all stamps of a segment, or None where their means over seconds depart from it.

    Medians of stamps that come at a few different latenesses would jump from one to another.
    """
    number = np.arange(t.size)
    slope, first = np.polyfit(number, t, 1)
    size = max(20, round(_BLOCK / slope))
    left = (t - first - slope * number)[: t.size // size * size].reshape(-1, size).mean(axis=1)
    straight = left.size > 0 and np.abs(left).max() < _OFF_LINE * slope
    return _Line(number, float(first), float(slope)) if straight else None


def _fitted(t: Array) -> _Line | None:
    """Return the line through the stamps of a segment, or None where they do not follow a line."""
    interval = float(np.median(t[_LAG:] - t[:-_LAG])) / _LAG
    if interval <= 0.0:
        return None
    one_by_one = np.arange(t.size)
    by_steps = np.concatenate([[0], np.cumsum(np.maximum(np.round(np.diff(t) / interval), 1.0)).astype(np.int64)])
    for number in (one_by_one, by_steps, None):
        counted = _by_envelope(t, interval) if number is None else number
        if counted is not None:
            line = _robust_line(t, counted, interval)
            if _straight(t - line.stamps, line.interval):
                return line
    return None


def _by_envelope(t: Array, interval: float) -> Stamps | None:
    """Return numbers of samples whose stamps may be late by several intervals, where some samples are missing.

    Late stamps return to the line; after a missing sample all stamps are one interval later. So the earliest of
    the following stamps shows how many samples are missing.
    """
    if t.size > _MAX_SEARCHED:
        return None
    window = max(20, round(0.2 / interval))
    number = np.arange(t.size)
    offset = t - interval * number
    for _ in range(t.size // 50):
        ahead = _earliest_ahead(offset, window)
        before = np.concatenate([[ahead[0]], _earliest_ahead(offset[::-1], window)[::-1][:-1]])
        jumps = np.flatnonzero(ahead - before > _ONE_MISSING * interval)
        if jumps.size == 0:
            return number
        k = int(jumps[0])
        missing = max(1, round(float(ahead[k] - before[k]) / interval))
        number[k:] += missing
        offset[k:] -= missing * interval
    return None


def _earliest_ahead(offset: Array, window: int) -> Array:
    """Return the minimum of every value and those that follow within a window, (n,)."""
    padded = np.concatenate([offset, np.full(window - 1, offset[-window:].min())])
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, window).min(axis=1))


def _robust_line(t: Array, number: Stamps, interval: float) -> _Line:
    """Return the line through stamps by reweighted least squares (Cauchy), its scale that of the median."""
    x = number.astype(float)
    middle = float(x.mean())
    slope, first = interval, float(np.median(t - interval * x))
    for _ in range(30):
        left = t - first - slope * x
        scale = max(1.5 * float(np.median(np.abs(left - np.median(left)))), 1e-9)
        weight = cauchy_weights(left, 2.0 * scale)
        total = float(weight.sum())
        centre = float(weight @ x) / total
        about = x - centre
        change = float((weight * about) @ left) / float((weight * about) @ about)
        shift = float(weight @ left) / total - change * centre
        first, slope = first + shift, slope + change
        if abs(shift + change * middle) < 1e-9 and abs(change) * x[-1] < 1e-9:
            break
    return _Line(number, first, slope)


def _straight(left: Array, interval: float) -> bool:
    """Return whether the residuals of stamps from a line have no trend over seconds."""
    size = max(20, round(_BLOCK / interval))
    count = left.size // size
    if count < 2:
        return _spread(left) < 0.5 * interval
    blocks = left[: count * size].reshape(count, size)
    middle = np.median(blocks, axis=1)
    # the median of so many scattered values is itself uncertain; a few blocks may contain a stall
    uncertain = 1.25 * _spread(left) / size**0.5
    away = np.abs(middle - np.median(middle))
    most, all_of_them = _STRAIGHT + 3.0 * uncertain, 4.0 * _STRAIGHT + 8.0 * uncertain
    return bool(np.percentile(away, 90) < most and away.max() < all_of_them)


def _spread(left: Array) -> float:
    """Return the robust standard deviation of residuals."""
    return 1.48 * float(np.median(np.abs(left - np.median(left))))


def _share_of_stamps(values: Array, seconds: Array, lines: list[tuple[slice, _Line]]) -> tuple[float, float]:
    """Return the slope of what values (n, k) differ by against what true stamps would cause, and its deviation.

    A value is compared with that which its neighbours give for its place in an even series. If it was taken earlier or
    later, as its stamp says, it differs by the slope of the signal times that time difference. Without any signal the
    slope is zero and its deviation infinite.
    """
    products = squares = left = 0.0
    count = 0
    for part, line in lines:
        even = np.flatnonzero((line.number[4:] - line.number[:-4]) == 4) + 2
        late = seconds[part] - line.stamps
        small = np.abs(late) < line.interval
        even = even[small[even] & small[even - 1] & small[even + 1] & small[even - 2] & small[even + 2]]
        if even.size < MIN_PART:
            continue
        for channel in values[part].T:
            off, moved = (_off_neighbours(x, even) for x in (channel, late))
            slope = (channel[even + 1] - channel[even - 1]) / (2.0 * line.interval)
            expected = slope * moved
            clear = np.abs(expected) > np.percentile(np.abs(expected), 50)
            products += float(off[clear] @ expected[clear])
            squares += float(expected[clear] @ expected[clear])
            left += float(off[clear] @ off[clear])
            count += int(np.count_nonzero(clear))
    if squares == 0.0:
        return 0.0, np.inf
    share = products / squares
    return share, float(np.sqrt(max(left - share * products, 0.0) / count / squares))


def _off_neighbours(x: Array, at: Stamps) -> Array:
    """Return the distances of values from the cubic through two neighbours on either side."""
    return np.asarray(x[at] - (4.0 * (x[at - 1] + x[at + 1]) - x[at - 2] - x[at + 2]) / 6.0)

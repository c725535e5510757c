"""Readings that stand for the samples lost before them, too: of sensors that accumulate until they are read.

A device that puts out angle and velocity increments since it was last read loses nothing with a message that does not
arrive: the next one holds the sum, or where it divides by the true interval, the mean.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from kreisel.estimation.robust import normal_scale
from kreisel.geometry.interpolation import interpolate_columns
from kreisel.geometry.rotation import Array, Indices
from kreisel.recording.location import at
from kreisel.recording.recording import DataWarning, ImuSamples
from kreisel.validation.masking import part_of

_MOST, _LONGEST_NS = 10, 5e7
"""Samples that one reading stands for at most, or their time. Chosen: neighbours then still resemble each other."""

_OFF = 0.2
"""Share of an interval by which a step may differ from a whole number of intervals. Chosen: jitter of most loggers."""

_LEAST = 3
"""Readings after lost samples from which it is judged. Chosen: one may be a fault of its own."""

_CLEAR = 0.1
"""Squares that one kind leaves, of those that any other leaves. Chosen: sums left 1e-3 or less, means 0.004 to 0.05."""

_WHOLE = 0.01
"""The same of a single sum from which it is cut off at the end of a range: a tenth of what it is more than a mean."""

_CERTAIN = 50.0
"""Difference of such squares, over those of usual readings, beyond which it shows. Chosen: 25 in the log-likelihood."""

_NOISE = 1.5
"""Squares that are left of what noise leaves, up to which it is noise: most of a recording may be rests, where steps of
one and of two are alike."""

_AROUND, _LONGER, _SPIKE, _SPIKES = 8, 1.5, 0.5, 0.5
"""Samples from which neighbours are compared; length, and difference from them, over theirs, from which an acceleration
stands out; and share of those that do from which they are sums. Chosen: knocks have any direction and size."""

_EVEN = 1.5
"""Ratio of the longest to the shortest distance of places up to which they are evenly spread. Chosen: a beat of two
rates changes by a few samples; in six places at random it is beyond 1.5 in 99 of 100."""


class _Kind(Enum):
    """What readings after lost samples are."""

    SAMPLE = "readings of one sample"
    SUM = "sums"
    MEAN = "means"


def with_lost_samples(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with lost ones restored where a reading stands for them, too, and the warning about it.

    A sum has the stamp of its last sample, or of its first: then it comes before the long step. Seen backwards in time,
    these are the same. Stamps that only count what arrives are corrected first.
    """
    counted = _with_steps_of_sums(imu)
    alone, kinds = _kinds(counted)
    if any(kind is not _Kind.SAMPLE for kind in kinds):
        place, number = _after_long_steps(counted, alone=False)
        return _divided(counted, place, number, kinds), [_warning(imu, place, kinds, "after")]
    if alone < _LEAST:
        return imu, []
    backwards = _backwards(imu)
    _, kinds = _kinds(backwards)
    if _Kind.SUM not in kinds or _Kind.MEAN in kinds:
        return imu, []
    place, number = _after_long_steps(backwards, alone=False)
    found = _backwards(_divided(backwards, place, number, kinds))
    return found, [_warning(imu, imu.stamps_ns.size - 1 - place[::-1], kinds, "before")]


def _backwards(imu: ImuSamples) -> ImuSamples:
    """Return the samples in reverse, with stamps from the last to the first."""
    back = part_of(imu, np.arange(imu.stamps_ns.size)[::-1])
    return replace(back, stamps_ns=imu.stamps_ns[0] + imu.stamps_ns[-1] - back.stamps_ns)


def with_steps_of_one(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples, after repeats were left out, without the steps that these took in stamps by count.

    A row that is written twice counts twice: the sample after it was taken one interval after the first, and lies in
    the middle between its neighbours, although its stamp does not. Repeats that come evenly are of a sensor that is
    asked more often than it measures; see `sampling`.
    """
    place, number = _after_long_steps(imu, alone=True)
    if place.size < _LEAST or _evenly(place):
        return imu, []
    left = [_left(values, values, place, number) for values in (imu.rates, imu.accelerations)]
    as_stamped, in_the_middle = (sum(float(one[kind].sum()) for one in left) for kind in (_Kind.SAMPLE, _Kind.MEAN))
    by_noise = in_the_middle < _NOISE * place.size * sum(values.shape[1] for values in (imu.rates, imu.accelerations))
    if as_stamped < in_the_middle + _CERTAIN or not (by_noise or as_stamped > 2.0 * in_the_middle):
        return imu, []
    interval, later = float(np.median(np.diff(imu.stamps_ns))), np.zeros(imu.stamps_ns.size)
    later[place] = number - 1
    stamps = imu.stamps_ns - np.round(np.cumsum(later) * interval).astype(np.int64)
    first = at(imu.source, imu.row_of(int(place[0])))
    text = (
        f"{imu.source.parent.name}: stamps count repeats, too: the samples after {place.size} of them, the first at "
        f"{first}, follow the ones before after one interval; all later stamps were set back by as much"
    )
    return replace(imu, stamps_ns=stamps), [DataWarning("stamps", text)]


def _with_steps_of_sums(imu: ImuSamples) -> ImuSamples:
    """Return the samples with long steps before accelerations that are sums, where stamps count what arrives.

    Gravity shows it: such a reading is a whole number of times what its neighbours are.
    """
    a = imu.accelerations
    if len(a) < _AROUND:
        return imu
    square = np.einsum("ij,ij->i", a, a)
    k = np.flatnonzero(square[2:-2] > _LONGER**2 * np.minimum(square[1:-3], square[3:-1])) + 2
    if k.size < _LEAST:
        return imu
    steps = np.diff(imu.stamps_ns)
    usual = float(np.median(steps))
    beside = np.array([-2, -1, 1, 2])[:, None]
    even = (np.abs(steps[k + np.arange(-2, 2)[:, None]] - usual) < _OFF * usual).all(axis=0)
    means, sums, number = a.copy(), np.zeros(k.size, dtype=bool), np.ones(k.size)
    for _ in range(2):  # sums beside sums are seen when those are divided
        around = np.median(means[k + beside], axis=0)
        size = np.maximum(np.sum(around**2, axis=1), 1e-300)
        number = np.round(np.sum(a[k] * around, axis=1) / size)
        off = even & (np.sum((a[k] - around) ** 2, axis=1) > _SPIKE**2 * size)
        left = np.sum((a[k] - number[:, None] * around) ** 2, axis=1)
        sums = off & (number >= 2) & (number <= _MOST) & (left < _CLEAR * _CLEAR * size)
        means[k[sums]] = a[k[sums]] / number[sums, None]
    if np.count_nonzero(sums) < max(_LEAST, _SPIKES * np.count_nonzero(off)):
        return imu
    later = np.zeros(imu.stamps_ns.size)
    later[k[sums]] = number[sums] - 1.0
    return replace(imu, stamps_ns=imu.stamps_ns + np.round(np.cumsum(later) * usual).astype(np.int64))


def _after_long_steps(imu: ImuSamples, *, alone: bool) -> tuple[Indices, Indices]:
    """Return the places after steps of several intervals, and of how many, (m,).

    alone: only those between single steps, whose neighbours stand for themselves.
    """
    steps = np.diff(imu.stamps_ns)
    usual = float(np.median(steps))
    if steps.max() < 1.5 * usual:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    steps = steps / usual
    count = np.round(steps).astype(np.int64)
    even = np.abs(steps - count) < _OFF
    most = max(_MOST, round(_LONGEST_NS / usual))
    beside = even & (count <= (1 if alone else most))
    place = np.flatnonzero(even[1:-1] & (count[1:-1] > 1) & (count[1:-1] <= most) & beside[:-2] & beside[2:]) + 2
    return place, count[place - 1]


def _kinds(imu: ImuSamples) -> tuple[int, list[_Kind]]:
    """Return how many places after long steps show it, and what rates and accelerations are there."""
    place, number = _after_long_steps(imu, alone=True)
    sensors = (imu.rates, imu.accelerations)
    kinds = [_kind(values, place, number) for values in sensors]
    for k, shown in ((0, kinds[1]), (1, kinds[0])):
        if kinds[k] is _Kind.SAMPLE and shown is not _Kind.SAMPLE:
            total = {kind: float(own.sum()) for kind, own in _left(sensors[k], sensors[k], place, number).items()}
            if min(total, key=lambda kind: total[kind]) is shown and total[_Kind.SAMPLE] > total[shown] + _CERTAIN:
                kinds[k] = shown  # less clear by itself, as of gyros at rest, but the device accumulates
    return place.size, kinds


def _kind(values: Array, place: Indices, number: Indices) -> _Kind:
    """Return what readings after lost samples are, by their neighbours.

    Parameters
    ----------
    values : (n, 3)
        Readings of one sensor.
    place, number : (m,)
        Readings after lost samples, and how many samples each would stand for.
    """
    if place.size < _LEAST:
        return _Kind.SAMPLE
    left = _left(values, values, place, number)
    if np.percentile(_share_left(left), 25.0) < _CLEAR:
        return _Kind.SUM  # others may be cut off
    total = {kind: float(own.sum()) for kind, own in left.items()}
    best, second, _ = sorted(total, key=lambda kind: total[kind])
    if total[best] > _CLEAR * total[second] or (best is _Kind.MEAN and _evenly(place)):
        return _Kind.SAMPLE
    return best


def _share_left(left: dict[_Kind, Array]) -> Array:
    """Return the squares that sums leave, over the least that readings of other kinds leave, (m,)."""
    return np.asarray(left[_Kind.SUM] / np.maximum(np.minimum(left[_Kind.SAMPLE], left[_Kind.MEAN]), 1e-300))


def _evenly(place: Indices) -> bool:
    """Return whether places are evenly spread: a sensor that is a little slower than it is asked skips one so.

    Its samples were taken one interval after the other, and one after a skip lies in the middle of its neighbours, too.
    """
    between = np.diff(place)
    return bool(between.max() <= _EVEN * between.min() + 1)


def _left(values: Array, beside: Array, place: Indices, number: Indices) -> dict[_Kind, Array]:
    """Return the squares (m,) that each kind would leave, over the variance that neighbours leave of usual readings.

    beside: (n, 3), the values of the neighbours.
    """
    before, after, n = beside[place - 1], beside[place + 1], number[:, None]
    middle = 0.5 * (before + after)  # of all the samples between the neighbours
    expected = {_Kind.SAMPLE: before + n / (n + 1.0) * (after - before), _Kind.SUM: n * middle, _Kind.MEAN: middle}
    usual = normal_scale(values[1:-1] - 0.5 * (values[:-2] + values[2:])) + 1e-300
    return {kind: np.sum(((values[place] - value) / usual) ** 2, axis=1) for kind, value in expected.items()}


def _divided(imu: ImuSamples, place: Indices, number: Indices, kinds: list[_Kind]) -> ImuSamples:
    """Return the samples with the lost ones put in: on straight lines, moved to have the mean that a reading gives."""
    repeats = np.ones(imu.stamps_ns.size, dtype=np.int64)
    repeats[place] = number
    source = np.repeat(np.arange(repeats.size), repeats)
    last = np.cumsum(repeats) - 1
    ends, at_all = last.astype(np.float64), np.arange(source.size, dtype=np.float64)
    stamps = np.interp(at_all, ends, imu.stamps_ns - imu.stamps_ns[0])
    new = imu.stamps_ns[0] + np.round(stamps).astype(np.int64)
    new[last] = imu.stamps_ns

    def filled(values: Array, kind: _Kind) -> Array:
        if kind is _Kind.SAMPLE:
            return interpolate_columns(at_all, ends, values)
        means = values / repeats[:, None] if kind is _Kind.SUM else values
        line = interpolate_columns(at_all, ends[repeats == 1], values[repeats == 1])
        whole = np.ones(repeats.size, dtype=bool)
        if kind is _Kind.SUM:
            whole[place] = _share_left(_left(values, means, place, number)) < _WHOLE
        of_line = np.add.reduceat(line, last - repeats + 1, axis=0) / repeats[:, None]
        return line + (whole[:, None] * (means - of_line))[source]

    rates, accelerations = (filled(*own) for own in zip((imu.rates, imu.accelerations), kinds, strict=True))
    return replace(part_of(imu, source), stamps_ns=new, rates=rates, accelerations=accelerations)


def _warning(imu: ImuSamples, place: Indices, kinds: list[_Kind], side: str) -> DataWarning:
    of = {name: kind for name, kind in zip(("rates", "accelerations"), kinds, strict=True) if kind is not _Kind.SAMPLE}
    first = at(imu.source, imu.row_of(int(place[0])))
    return DataWarning(
        "accumulated",
        f"{imu.source.parent.name}: {place.size} {' and '.join(of)} {side} lost samples, the first at {first}, are "
        f"{' and '.join(dict.fromkeys(kind.value for kind in of.values()))} over these and themselves, "
        "as of a sensor that accumulates until it is read; the lost samples were restored by them",
    )

"""Samples of an IMU that show no motion, found and left out: saturated, spikes, frozen and stuck readings.

A few of them cost little: the motion is bridged, or, where a reading was cut off and nobody knows how large it would
have been, navigation starts anew after it. A recording with many of them is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.recording.location import and_more, at, fault, rows
from kreisel.recording.recording import DataWarning, ImuSamples, Stamps, chunks, rows_of
from kreisel.validation.stamp_checks import runs

CHANNELS = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")

MAX_MASKED = 0.02
"""Share of all samples that may be left out because of one kind of fault."""

_LONG_FREEZE = 8
"""Repetitions of all channels from which readings are frozen; fewer are those of a log that is faster than the sensor.
Chosen: a sensor at 125 Hz repeats seven times in a log at 1 kHz."""

_RUNS, _ALIKE, _MOSTLY = 20, 0.2, 0.9
"""Runs of repetitions, share by which their lengths differ, and share of all, where a log is faster than the sensor.
Chosen: a sensor's clock scatters by less, and a driver that stalls, or a sensor at rest, does so rarely."""

_STUCK = 20
"""Repetitions of one channel, while others change, from which it is stuck or saturated. Chosen: a channel that rarely
repeats a value does not repeat it twenty times in a row."""

_FEW = 3.0
"""Last digits, or usual steps, by which other axes change at most at rest, where one shows no change. Chosen: noise
that moves one axis by less than half a digit either way, three times larger; six deviations of noise in 20 samples."""

_EDGES = 5
"""Part of such a rest, at either end, in which other axes may still move. Chosen: motion begins and ends smoothly, and
turns less about some axes than about others."""

_SPIKE = 30.0
"""Size of a step, in usual ones, from which it is none of a motion. Chosen: above shocks, which last for several
samples and make the usual steps larger; a step is a small part of a reading, and spikes of the virtual cell are ten
usual readings high."""

_WHOLE_STEP = "a step over the whole range"

_ENDS = 0.1
"""Share of a step by which its middle lies beside zero, or one of its ends does, where it is one over the range.
Chosen: what a reading moves by in a sample is less."""

_BROKEN, _BROKEN_NS = 4, 40e6
"""Samples that a spike lasts at most, and ns. Chosen: as many as a broken packet holds; what lasts longer may be a
motion."""

_OVERLAP = 512
"""Samples of the chunk before that are looked at again. Chosen: more than the 200 beside a stay that decide about
it."""

_MAX_ROUNDS = 4  # searches without what was found before; chosen: they end as soon as nothing is found

_ENOUGH = 20_000
"""Steps of which a percentile is taken. Chosen: 200 of them lie above the 99th, known to 7 %, the root of 1 / 200."""

_BESIDE = 1
"""Samples on either side of a saturated one that are left out too: a filter in the sensor has rounded the edge."""


@dataclass(frozen=True)
class _Chunk:
    """Consecutive samples, all six channels (n, 6); `first` is the number of the first, `last` whether none follow."""

    source: Path
    first: int
    last: bool
    stamps_ns: Stamps
    values: Array

    @cached_property
    def steps(self) -> Array:
        """Sizes of the steps from sample to sample, (n - 1, 6)."""
        return np.abs(np.diff(self.values, axis=0))

    @cached_property
    def repeats(self) -> Mask:
        """Which steps are zero, (n - 1, 6)."""
        return np.asarray(self.steps == 0.0)

    @cached_property
    def still(self) -> Mask:
        """Which samples are followed by the same values in all channels."""
        return np.asarray(self.repeats.all(axis=1))

    @cached_property
    def digits(self) -> Array:
        """The smallest step of every channel, (6,)."""
        return resolution(self.steps)

    @cached_property
    def large_steps(self) -> tuple[Array, Mask, Mask]:
        """Usual steps of all channels, which steps are far larger, and which samples (n, 6) are spikes between two."""
        steps = self.steps
        many = _usual(steps, 75.0)
        highest = steps.max(axis=0)
        if not (highest > _SPIKE * many).any():
            return many, np.zeros(steps.shape, dtype=bool), np.zeros(self.values.shape, dtype=bool)
        # spikes themselves must not decide what is usual
        spikes = self._excursions(steps > _SPIKE * many)
        usual = _usual(np.where(spikes[1:] | spikes[:-1], 0.0, steps), 99.0)
        limit = _SPIKE * usual
        large = (steps > limit) & (limit > 0.0)
        if large.any():
            dt = np.diff(self.stamps_ns)
            large &= (dt < 1.6 * float(np.median(dt)))[:, None]
        return usual, large, self._excursions(large)

    def _excursions(self, large: Mask) -> Mask:
        """Return which samples (n, 6) lie between a large step and one back.

        That is the next one, or one a few samples later with even readings on both sides: a knock rings.
        """
        values, steps = self.values, self.steps
        beside = np.pad(large, ((1, 1), (0, 0)))
        out = np.zeros(values.shape, dtype=bool)
        step = max(float(np.median(np.diff(self.stamps_ns))), 1.0)
        for length in range(1, 1 + max(1, min(_BROKEN, int(_BROKEN_NS / step)))):
            k, channel = np.nonzero(large[:-length] & large[length:])
            height = np.minimum(steps[k, channel], steps[k + length, channel])
            back = np.abs(values[k + length + 1, channel] - values[k, channel]) < 0.3 * height
            if length > 1:
                back &= ~beside[k, channel] & ~beside[k + length + 2, channel]
            for place in range(1, length + 1):
                out[k[back] + place, channel[back]] = True
        return out

    @cached_property
    def whole_steps(self) -> tuple[Mask, Mask]:
        """The steps over the whole range, (n - 1, 6): those of readings that wrap round, and others.

        Readings wrap round between the ends of a range that is symmetric, or begins at zero, and go on evenly.
        """
        _, large, spikes = self.large_steps
        none = np.zeros(large.shape, dtype=bool)
        if not large.any():
            return none, none
        values, steps = self.values, self.steps
        found = large & (steps > 0.9 * np.ptp(values, axis=0))
        found &= ~spikes[:-1] & ~spikes[1:]
        found[-1] &= self.last  # the next chunk shows whether it comes back
        between = values[1:] + values[:-1]
        ends = np.abs(np.where(values.min(axis=0) < 0.0, between, between - steps)) < _ENDS * steps
        even = np.ones(large.shape, dtype=bool)
        even[1:] &= ~large[:-1]
        even[:-1] &= ~large[1:]
        return found & ends & even, found & ~(ends & even)

    @cached_property
    def stays(self) -> tuple[tuple[str, float, slice, str], ...]:
        """Channels that stay the same while the others change."""
        return tuple(_stays(self))

    @property
    def whole(self) -> slice:
        """Its place among all samples."""
        return slice(self.first, self.first + len(self.values))

    def stalls(self) -> tuple[Indices, Indices, Array]:
        """Return first and last samples of the runs in which all channels repeat, and the steps that end them."""
        starts, stops = runs(self.still)
        ended = stops < len(self.still)
        starts, stops = starts[ended], stops[ended]
        return starts, stops, self.steps[stops]

    def fault(self, text: str, samples: Mask | slice | Indices, first: int) -> _Fault:
        """Return a fault of some of its samples."""
        mask = np.zeros(len(self.values), dtype=bool)
        mask[samples] = True
        return _Fault(text, first, mask)


@dataclass(frozen=True)
class _Fault:
    """Readings that show no motion: what they look like, the first one, and all of the chunk's, (n,)."""

    text: str
    first: int
    samples: Mask


_Find = Callable[[_Chunk], Iterator[_Fault]]


@dataclass
class _Found:
    """What was found of one kind of fault, in numbers of samples as recorded.

    Attributes
    ----------
    find
        Returns the faults of a chunk.
    advice
        For a recording with too many of them.
    most
        Share of all samples that may be left out.
    samples : (n,)
        Which they are.
    text, place
        Of the first one.
    at_rest
        Advice where the device also stands still, if it is another.
    """

    find: _Find
    advice: str
    samples: Mask
    most: float = MAX_MASKED
    text: str = ""
    place: int = 0
    at_rest: str = ""

    def add(self, one: _Fault, numbers: Indices) -> None:
        """Add a fault of a chunk whose samples have these numbers."""
        if not self.text:
            self.text, self.place = one.text, int(numbers[one.first])
        self.samples[numbers[one.samples]] = True


def resolution(steps: Array) -> Array:
    """Return the smallest step of every channel, (channels,): the size of its last digit, if it has few digits.

    Parameters
    ----------
    steps : (n, channels)
        Sizes of the steps from sample to sample.
    """
    smallest = []
    for channel in _some(steps).T:
        real = channel[channel > 1e-9 * channel.max()]
        smallest.append(float(np.percentile(real, 1)) if real.size else 0.0)
    return np.array(smallest)


def without_faults(imu: ImuSamples, *, moved: bool) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without those that show no motion, and the warnings about them.

    Parameters
    ----------
    moved
        Whether the IMU was moved. If not, they are only reported, and saturated ones marked as broken.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    n, delete = imu.stamps_ns.size, f"delete these {rows(imu.source)} (a gap is bridged)"
    saturated = _Found(_saturated, "move more gently, or choose a larger range", np.zeros(n, dtype=bool))
    kinds = [
        saturated,
        _Found(_wrapped, "the reading exceeded its range and wrapped round: choose a larger range",
               np.zeros(n, dtype=bool), most=0.0),
        _Found(_disturbed, f"{delete}, and check the connection: these are no readings of a motion",
               np.zeros(n, dtype=bool), most=0.0),
        _Found(_spikes, delete, np.zeros(n, dtype=bool)),
        _Found(_frozen, f"{delete}, and check whether the driver stalled", np.zeros(n, dtype=bool)),
        _Found(_stuck, f"a stuck or dead channel; {delete}, and check the sensor", np.zeros(n, dtype=bool),
               at_rest="a stuck channel, or one whose steps are larger than its noise while the device rests"),
    ]  # fmt: skip
    left, numbers = imu, np.arange(n)
    for _ in range(_MAX_ROUNDS):  # large spikes hide smaller ones
        keep = np.ones(numbers.size, dtype=bool)
        for chunk in _chunks(left):
            for kind in kinds:
                for one in kind.find(chunk):
                    kind.add(one, numbers[chunk.whole])
                    keep[chunk.whole] &= ~one.samples
        if keep.all() or not moved:
            break
        for kind in kinds:
            _check_share(kind, imu)
        left, numbers = part_of(left, keep), numbers[keep]
    left = replace(left, broken_ns=imu.stamps_ns[saturated.samples])
    return left, [_warning(kind, imu, moved=moved, breaks=kind is saturated) for kind in kinds if kind.text]


def without_spikes(imu: ImuSamples) -> tuple[ImuSamples, int]:
    """Return the samples without spikes of one sample, and how many these were; all where they are too many to be."""
    left = imu
    for _ in range(_MAX_ROUNDS):  # large spikes hide smaller ones
        keep = np.ones(left.stamps_ns.size, dtype=bool)
        for chunk in _chunks(left):
            for one in _spikes(chunk):
                keep[chunk.whole] &= ~one.samples
        if keep.all():
            break
        left = part_of(left, keep)
    count = imu.stamps_ns.size - left.stamps_ns.size
    return (left, count) if count <= MAX_MASKED * imu.stamps_ns.size else (imu, 0)


def _check_share(kind: _Found, imu: ImuSamples) -> None:
    """Raise the error for more faults of one kind than can be left out."""
    count = int(kind.samples.sum())
    if count > kind.most * kind.samples.size:
        places = runs(kind.samples)[0].size
        raise fault(imu.source, f"{kind.text}{and_more(places - 1, 'places')}; {kind.advice}", imu.row_of(kind.place))


def _warning(kind: _Found, imu: ImuSamples, *, moved: bool, breaks: bool) -> DataWarning:
    """Return the warning about faults of one kind."""
    places, count = runs(kind.samples)[0].size, int(kind.samples.sum())
    more = and_more(places - 1, "places")
    if not moved:
        return DataWarning("imu", f"{kind.text}{more}; {kind.at_rest or kind.advice}")
    end = "navigation starts anew after them" if breaks else "the motion is bridged"
    left_out = f"{count} samples are left out, and {end}" if count > 1 else "this sample is left out"
    return DataWarning("masked", f"{at(imu.source, imu.row_of(kind.place))}: {kind.text}{more}; {left_out}")


def without_repeats(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without those that only repeat the one before, and the warning about them.

    All six channels also repeat for a sensor with few digits at standstill, whose next change is small, and for a
    sensor without noise; their samples are kept.
    """
    keep = np.ones(imu.stamps_ns.size, dtype=bool)
    for chunk in _chunks(imu):
        starts, stops, jumps = chunk.stalls()
        longest = _longest_repeat(stops - starts, chunk.still)
        stale = (stops - starts < longest) & (jumps > 3.0 * chunk.digits).any(axis=1)
        keep[chunk.whole] &= first_of_each(len(chunk.values), starts[stale], stops[stale])
    dropped = int(np.sum(~keep))
    if not dropped:
        return imu, []
    text = (
        f"{imu.source.parent.name}: {dropped} of {keep.size} samples only repeat the one before and were left out"
        f"{'; log the sensor at its own rate' if dropped > 0.1 * keep.size else ''}"
    )
    return part_of(imu, keep), [DataWarning("repeats", text)]


def _longest_repeat(lengths: Indices, still: Mask) -> float:
    """Return how many times a reading repeats at least where a sensor is frozen, by lengths of runs that repeat.

    Where most samples repeat, and about as often each time, the log is that much faster than the sensor.
    """
    if lengths.size < _RUNS or np.mean(still) < 0.5:
        return _LONG_FREEZE
    usual = float(np.median(lengths))
    alike = np.mean(np.abs(lengths - usual) <= 1.0 + _ALIKE * usual)
    return max(_LONG_FREEZE, 2.0 * usual + 2.0) if alike > _MOSTLY else _LONG_FREEZE


def part_of(imu: ImuSamples, keep: Mask | Indices) -> ImuSamples:
    """Return the samples that a mask or indices select."""
    temperature = None if imu.temperature is None else imu.temperature[keep]
    return replace(
        imu,
        stamps_ns=imu.stamps_ns[keep],
        rates=imu.rates[keep],
        accelerations=imu.accelerations[keep],
        temperature=temperature,
        rows=rows_of(imu.rows, imu.stamps_ns.size, keep),
    )


def first_of_each(size: int, starts: Indices, stops: Indices) -> Mask:
    """Return the mask that leaves out all but the first of every run.

    Parameters
    ----------
    starts, stops
        First and last index of the runs.
    """
    change = np.zeros(size + 1, dtype=np.int64)
    np.add.at(change, starts + 1, 1)
    np.add.at(change, stops + 1, -1)
    return np.asarray(np.cumsum(change)[:size] == 0)


def _chunks(imu: ImuSamples) -> Iterator[_Chunk]:
    """Yield all samples in chunks, each with the end of the one before."""
    n = imu.stamps_ns.size
    for part in chunks(n):
        wide = slice(max(part.start - _OVERLAP, 0), part.stop)
        values = np.hstack([imu.rates[wide], imu.accelerations[wide]])
        yield _Chunk(imu.source, wide.start, part.stop == n, imu.stamps_ns[wide], values)


def _usual(steps: Array, share: float) -> Array:
    """Return a percentile of the steps that are not zero, (channels,)."""
    real = (channel[channel > 0.0] for channel in _some(steps).T)
    return np.array([float(np.percentile(own, share)) if own.size else 0.0 for own in real])


def _some(steps: Array) -> Array:
    """Return the steps; of many some, which are enough."""
    return steps[:: max(1, len(steps) // _ENOUGH)]


def _saturated(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield channels that stay at their extreme value while the motion goes on.

    Before a natural peak the slope decreases: before a plateau of n samples, with digits of size d, it is at
    most about 6 d / n. Before a clipped peak the slope is steep.
    """
    still = np.concatenate([[False], chunk.still])
    for channel, name in enumerate(CHANNELS):
        x = chunk.values[:, channel]
        for extreme, word in ((x.max(), "largest"), (x.min(), "smallest")):
            flat = (x == extreme) & ~still
            starts, stops = runs(flat)
            longest = int((stops - starts).max(initial=0))
            before = max(1, min(longest // 2, 20))
            plateau = (stops - starts >= 3) & (starts > before)
            if int(flat.sum()) < 5 or not plateau.any():
                continue
            edge = starts[plateau] - 1
            slope = float(np.median(np.abs(x[edge] - x[edge - before]))) / before
            if slope > max(12.0 * chunk.digits[channel] / longest, 2e-4 * float(np.std(x))):
                beside = np.convolve(flat, np.ones(2 * _BESIDE + 1), mode="same") > 0.5
                yield chunk.fault(
                    f"{name} is saturated: it stays at its {word} value {extreme:.6g} for up to {longest} samples, "
                    f"{int(flat.sum())} in total",
                    beside,
                    int(starts[plateau][0]),
                )
    for name, value, inside, ending in chunk.stays:
        x = chunk.values[:, CHANNELS.index(name)]
        if value in (x.max(), x.min()):
            word = "largest" if value == x.max() else "smallest"
            text = (
                f"{name} is saturated: it stays at its {word} value {value:.6g} for {_length(inside)} samples, {ending}"
            )
            yield chunk.fault(text, slice(max(inside.start - _BESIDE, 0), inside.stop + _BESIDE), inside.start)


def _spikes(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield spikes of a few samples."""
    usual, _, spikes = chunk.large_steps
    yield from _steps(chunk, spikes[1:], usual, "a spike")


def _wrapped(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield channels that overflow their range and wrap round."""
    yield from _steps(chunk, chunk.whole_steps[0], chunk.large_steps[0], _WHOLE_STEP)


def _disturbed(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield channels that jump to and fro for more samples than a spike has."""
    yield from _steps(chunk, chunk.whole_steps[1], chunk.large_steps[0], _WHOLE_STEP)


def _steps(chunk: _Chunk, found: Mask, usual: Array, kind: str) -> Iterator[_Fault]:
    """Yield the fault of all samples after some steps."""
    where = np.flatnonzero(found.any(axis=1))
    if where.size:
        k = int(where[0])
        channel = int(np.argmax(found[k]))
        a, b = chunk.values[k : k + 2, channel]
        text = (
            f"{kind} in {CHANNELS[channel]}: from {a:.4g} to {b:.4g} in one sample, where steps are usually below "
            f"{usual[channel]:.3g}"
        )
        yield chunk.fault(text, where + 1, k + 1)


def _frozen(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield places where all channels freeze and then jump: a real motion from standstill starts gradually."""
    starts, stops, jumps = chunk.stalls()
    frozen = stops - starts >= _LONG_FREEZE
    if not frozen.any():
        return
    usual = np.percentile(chunk.steps, 90, axis=0) + 1e-12
    frozen &= (jumps / usual).max(axis=1, initial=0.0) > 4.0
    for start, stop in zip(starts[frozen], stops[frozen], strict=True):
        text = f"all readings are frozen for {stop - start + 1} samples, then jump"
        yield chunk.fault(text, slice(int(start) + 1, int(stop) + 1), int(start) + 1)


def _stuck(chunk: _Chunk) -> Iterator[_Fault]:
    """Yield intervals in which one channel stays the same, but not at the end of its range."""
    for name, value, inside, ending in chunk.stays:
        x = chunk.values[:, CHANNELS.index(name)]
        if value not in (x.max(), x.min()):
            text = f"{name} stays at {value:.4g} for {_length(inside)} samples, {ending}"
            yield chunk.fault(text, inside, inside.start)


def _length(inside: slice) -> int:
    """Return the number of samples with the same value: the first of them is not left out."""
    return int(inside.stop - inside.start) + 1


def _stays(chunk: _Chunk) -> Iterator[tuple[str, float, slice, str]]:
    """Yield channels that stay the same while the others change: name, value, repeated samples, and how they end.

    This is natural only where the channel hardly changes: at standstill, where the other axes of its sensor do not
    either, or at the top of a peak, where it changes by nine digits at most over as many samples again.
    """
    steps = chunk.steps
    for channel, name in enumerate(CHANNELS):
        x = chunk.values[:, channel]
        same = chunk.repeats[:, channel] & ~chunk.still
        starts, stops = runs(same)
        long = (stops - starts >= _STUCK) & (stops - starts < 0.99 * same.size)
        if not long.any():
            continue
        digits, usual = chunk.digits[channel], _usual(steps[:, channel : channel + 1], 90.0)[0]
        natural = float(np.mean(same)) - float(np.sum((stops - starts)[long])) / same.size
        for start, stop in zip(starts[long].tolist(), stops[long].tolist(), strict=True):
            jump = float(steps[stop, channel]) if stop < len(steps) else 0.0
            jumps = jump > max(4.0 * usual, 5.0 * digits)
            around = min(stop - start, 200)
            moved = max(
                float(np.ptp(x[max(start - around, 0) : start + 1])), float(np.ptp(x[stop : stop + around + 1]))
            )
            # a channel that rarely repeats a value does not repeat it twenty times in a row, unless nothing moves
            if jumps or (natural < 0.2 and moved > 20.0 * digits and not _rests(chunk, channel, start, stop)):
                ending = "then jumps" if jumps else "while the others change"
                yield name, float(x[start]), slice(start + 1, stop + 1), ending


def _rests(chunk: _Chunk, channel: int, start: int, stop: int) -> bool:
    """Return whether nothing moves between start and stop; at either end axes come to rest one after another.

    The other axes of the channel's sensor change by a few digits at most, and those of the other sensor by a few steps.
    """
    edge = (stop - start) // _EDGES
    low = 3 * (channel // 3)
    own, other = [k for k in range(low, low + 3) if k != channel], [k for k in range(6) if not low <= k < low + 3]
    changed = np.ptp(chunk.values[start + edge : stop + 1 - edge], axis=0)
    steps = _usual(chunk.steps, 90.0)
    return bool((changed[own] <= _FEW * chunk.digits[own]).all() and (changed[other] <= _FEW * steps[other]).all())

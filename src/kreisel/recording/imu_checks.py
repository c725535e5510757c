"""Checks of an IMU's readings by themselves.

Every check looks for something that no sensor in motion does: six noisy channels that repeat the same values,
a peak that is cut off flat, a step of thirty times the usual size up and back.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.recording.header import UNITS
from kreisel.recording.location import and_more, fault, is_table, rows, wrong_unit
from kreisel.recording.recording import DataWarning, ImuSamples, Stamps, chunks, excerpt
from kreisel.recording.stamp_checks import runs
from kreisel.units import STANDARD_GRAVITY

CHANNELS = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")

IMPOSSIBLE = 1e9
"""A number of this size or larger cannot be a reading in any unit."""

_LONG_FREEZE = 8
_STUCK = 20
_SPIKE = 30.0
_OVERLAP = 512


_COLDEST, _HOTTEST = -80.0, 200.0
"""Degrees Celsius, of a sensor that works."""


def check_imu(imu: ImuSamples, *, moved: bool) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without repeated ones, and the warnings about them.

    Parameters
    ----------
    moved
        Whether a reference was recorded with them. Without one the sensor may stand still, and a dead
        channel or a shock gives only a warning.

    Raises
    ------
    RecordingError
        For the first fault that would make results wrong.
    """
    for columns, names in ((imu.rates, CHANNELS[:3]), (imu.accelerations, CHANNELS[3:])):
        check_finite(columns, names, imu.source)
    if imu.temperature is not None:
        check_finite(imu.temperature[:, None], ("temperature",), imu.source)
        low, high = float(imu.temperature.min()), float(imu.temperature.max())
        if not (low > _COLDEST and high < _HOTTEST):
            raise RecordingError(
                f"temperature from {low:.4g} to {high:.4g} degrees Celsius; name its unit in the header, "
                "[degC] or [K], or leave the column out",
                file=imu.source,
            )
    _check_filled(imu)
    _check_gravity(imu)
    warnings: list[DataWarning] = []
    for check_whole in (_check_dead, _check_copies):
        with _as_warnings(warnings, moved=moved):
            check_whole(imu)
    keep = np.ones(imu.stamps_ns.size, dtype=bool)
    waiting = [_check_saturation, _check_steps, _check_frozen, _check_stuck]
    for chunk in _chunks(imu):
        for check in list(waiting):
            with _as_warnings(warnings, moved=moved) as failed:
                check(chunk)
            if failed:
                waiting.remove(check)
        keep[chunk.first : chunk.first + len(chunk.values)] &= _fresh(chunk)
    return _without_repeats(imu, keep, warnings)


@contextmanager
def _as_warnings(warnings: list[DataWarning], *, moved: bool) -> Iterator[list[str]]:
    """Turn the error of a check into a warning where nothing was moved; yield a list that holds its message."""
    failed: list[str] = []
    try:
        yield failed
    except RecordingError as error:
        if moved:
            raise
        failed.append(error.message)
        warnings.append(DataWarning("imu", error.message))


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

    def stalls(self) -> tuple[Indices, Indices, Array]:
        """Return first and last samples of the runs in which all channels repeat, and the steps that end them."""
        starts, stops = runs(self.still)
        ended = stops < len(self.still)
        starts, stops = starts[ended], stops[ended]
        return starts, stops, self.steps[stops]

    def fault(self, message: str, k: int) -> RecordingError:
        """Return the error at one of its samples."""
        return fault(self.source, message, self.first + k)


def _chunks(imu: ImuSamples) -> Iterator[_Chunk]:
    """Yield all samples in chunks, each with the end of the one before."""
    n = imu.stamps_ns.size
    for part in chunks(n):
        wide = slice(max(part.start - _OVERLAP, 0), part.stop)
        values = np.hstack([imu.rates[wide], imu.accelerations[wide]])
        yield _Chunk(imu.source, wide.start, part.stop == n, imu.stamps_ns[wide], values)


def check_finite(values: Array, names: tuple[str, ...], source: Path) -> None:
    """Raise an error for the first value that is not a number, or that is of impossible size.

    Raises
    ------
    RecordingError
        With its place.
    """
    where = np.flatnonzero(~((values > -IMPOSSIBLE) & (values < IMPOSSIBLE)).all(axis=1))
    if where.size:
        k = int(where[0])
        channel = int(np.argmin(np.abs(values[k]) < IMPOSSIBLE))
        raise fault(
            source,
            f"{names[channel]} = {values[k, channel]:.4g} is not a possible reading, here"
            f"{and_more(where.size - 1, rows(source))}; delete these {rows(source)} (a gap is bridged)",
            k,
        )


def _check_filled(imu: ImuSamples) -> None:
    """Raise an error for samples whose accelerations are all zero: gravity is always measured."""
    empty = np.flatnonzero((imu.accelerations == 0.0).all(axis=1))
    if empty.size == imu.stamps_ns.size:
        raise RecordingError("all accelerations are zero: record the accelerometers too", file=imu.source)
    if empty.size:
        raise fault(
            imu.source,
            f"all accelerations are exactly zero here{and_more(empty.size - 1, rows(imu.source))}, but gravity is "
            f"always measured: lost samples were filled with zeros; delete these {rows(imu.source)} (a gap is bridged)",
            int(empty[0]),
        )


def _check_gravity(imu: ImuSamples) -> None:
    """Raise an error if the accelerometers do not read about one g; it names the unit that would fit."""
    length = _usual_length(imu.accelerations)
    if 4.0 < length < 25.0:
        return
    got = f"accelerations have a median length of {length:.4g}, expected {STANDARD_GRAVITY:.4g} m/s^2 or a little more"
    for unit in ("g", "mg", "m s^-2"):
        factor = UNITS["acceleration"][unit] / imu.units.size("acceleration")
        if factor != 1.0 and 0.6 * STANDARD_GRAVITY < length * factor < 1.6 * STANDARD_GRAVITY:
            raise wrong_unit(imu, got, "acceleration", factor)
    if 4.0 < _usual_length(imu.rates) < 25.0:
        advice = "the rates seem to be in their columns: put rates first, accelerations after them"
    elif length < 4.0:
        advice = "was gravity removed, or are the columns in another order? Raw readings are needed"
    else:
        advice = "are they raw counts? Convert them to m/s^2"
    raise RecordingError(f"{got}; {advice}", file=imu.source, line=1 if is_table(imu.source) else None)


def _usual_length(vectors: Array) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(part, axis=1) for part in excerpt(vectors)])))


def _channels(imu: ImuSamples) -> list[Array]:
    return [*imu.rates.T, *imu.accelerations.T]


def _check_dead(imu: ImuSamples) -> None:
    dead = [(name, x[0]) for name, x in zip(CHANNELS, _channels(imu), strict=True) if x.max() == x.min()]
    if dead:
        names = ", ".join(f"{name} (always {value:.4g})" for name, value in dead)
        raise RecordingError(
            f"dead channel: {names} never changes; check the sensor and the columns, and record again",
            file=imu.source,
        )


def _check_copies(imu: ImuSamples) -> None:
    for (a, x), (b, y) in combinations(zip(CHANNELS, _channels(imu), strict=True), 2):
        if x[0] == y[0] and np.array_equal(x, y):
            raise RecordingError(
                f"{a} and {b} hold the same numbers in all rows; one column was written twice: "
                "check how the file was made, and record again",
                file=imu.source,
                line=1 if is_table(imu.source) else None,
            )


def resolution(steps: Array) -> Array:
    """Return the smallest step of every channel, (channels,): the size of its last digit, if it has few digits.

    Parameters
    ----------
    steps : (n, channels)
        Sizes of the steps from sample to sample.
    """
    smallest = []
    for channel in steps.T:
        real = channel[channel > 1e-9 * channel.max()]
        smallest.append(float(np.percentile(real, 1)) if real.size else 0.0)
    return np.array(smallest)


def _usual(steps: Array, share: float) -> Array:
    """Return a percentile of the steps that are not zero, (channels,)."""
    return np.array([float(np.percentile(x[x > 0.0], share)) if (x > 0.0).any() else 0.0 for x in steps.T])


def _check_saturation(chunk: _Chunk) -> None:
    """Raise an error for a channel that stays at its extreme value while the motion goes on.

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
                raise chunk.fault(
                    f"{name} is saturated: it stays at its {word} value {extreme:.6g} for up to {longest} samples, "
                    f"{int(flat.sum())} in total; move more gently, or choose a larger range",
                    int(starts[plateau][0]),
                )


def _check_steps(chunk: _Chunk) -> None:
    """Raise an error for spikes of one sample, and for channels that overflow their range and wrap round."""
    source, values, steps = chunk.source, chunk.values, chunk.steps
    limit = _SPIKE * _usual(steps, 99.0)
    if not ((steps.max(axis=0) > limit) & (limit > 0.0)).any():
        return
    dt = np.diff(chunk.stamps_ns)
    large = (steps > limit) & (limit > 0.0) & (dt < 1.6 * float(np.median(dt)))[:, None]
    back = np.abs(values[2:] - values[:-2]) < 0.3 * np.minimum(steps[1:], steps[:-1])
    spikes = large[1:] & large[:-1] & back
    wraps = large & (steps > 0.9 * np.ptp(values, axis=0))
    wraps[-1] &= chunk.last  # the next chunk shows whether it comes back
    wraps[:-1] &= ~spikes
    wraps[1:] &= ~spikes
    for found, kind, advice in (
        (spikes, "a spike", f"delete these {rows(source)} (a gap is bridged)"),
        (
            wraps,
            "a step over the whole range",
            "the reading exceeded its range and wrapped round: choose a larger range",
        ),
    ):
        where = np.flatnonzero(found.any(axis=1))
        if where.size:
            k = int(where[0])
            channel = int(np.argmax(found[k]))
            raise chunk.fault(
                f"{kind} in {CHANNELS[channel]}: from {values[k, channel]:.4g} to {values[k + 1, channel]:.4g} in one "
                f"sample{and_more(where.size - 1, rows(source))}; steps are usually below "
                f"{limit[channel] / _SPIKE:.3g}; {advice}",
                k + 1,
            )


def _check_frozen(chunk: _Chunk) -> None:
    """Raise an error where all channels freeze and then jump: a real motion from standstill starts gradually."""
    starts, stops, jumps = chunk.stalls()
    frozen = stops - starts >= _LONG_FREEZE
    if not frozen.any():
        return
    usual = np.percentile(chunk.steps, 90, axis=0) + 1e-12
    frozen &= (jumps / usual).max(axis=1, initial=0.0) > 4.0
    if frozen.any():
        k = int(np.flatnonzero(frozen)[0])
        raise chunk.fault(
            f"all readings are frozen for {stops[k] - starts[k] + 1} samples, then jump"
            f"{and_more(int(frozen.sum()) - 1, 'places')}; delete these {rows(chunk.source)} (a gap is bridged), "
            "and check whether the driver stalled",
            int(starts[k]) + 1,
        )


def _check_stuck(chunk: _Chunk) -> None:
    """Raise an error for one channel that stays the same while the others change.

    This is natural only where the channel hardly changes: at standstill, or at the top of a peak, where it
    changes by nine digits at most over as many samples again.
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
        for start, stop in zip(starts[long], stops[long], strict=True):
            jump = float(steps[stop, channel]) if stop < len(steps) else 0.0
            jumps = jump > max(4.0 * usual, 5.0 * digits)
            around = int(min(stop - start, 200))
            moved = max(
                float(np.ptp(x[max(start - around, 0) : start + 1])), float(np.ptp(x[stop : stop + around + 1]))
            )
            # a channel that rarely repeats a value does not repeat it twenty times in a row
            if jumps or (natural < 0.2 and moved > 20.0 * digits):
                ending = "then jumps" if jumps else "while the others change"
                raise chunk.fault(
                    f"{name} stays at {x[start]:.4g} for {stop - start + 1} samples, {ending}: a stuck or dead "
                    f"channel; delete these {rows(chunk.source)}, and check the sensor",
                    int(start) + 1,
                )


def _fresh(chunk: _Chunk) -> Mask:
    """Return the mask without samples that only repeat the one before: the logger may be faster than the sensor.

    All six channels also repeat for a sensor with few digits at standstill, whose next change is small, and for a
    sensor without noise; their samples are kept.
    """
    starts, stops, jumps = chunk.stalls()
    stale = (stops - starts < _LONG_FREEZE) & (jumps > 3.0 * chunk.digits).any(axis=1)
    return first_of_each(len(chunk.values), starts[stale], stops[stale])


def _without_repeats(imu: ImuSamples, keep: Mask, warnings: list[DataWarning]) -> tuple[ImuSamples, list[DataWarning]]:
    dropped = int(np.sum(~keep))
    if not dropped:
        return imu, warnings
    warning = DataWarning(
        "repeats",
        f"{imu.source.parent.name}: {dropped} of {keep.size} samples only repeat the one before and were left out"
        f"{'; log the sensor at its own rate' if dropped > 0.1 * keep.size else ''}",
    )
    temperature = None if imu.temperature is None else imu.temperature[keep]
    fresh = replace(
        imu,
        stamps_ns=imu.stamps_ns[keep],
        rates=imu.rates[keep],
        accelerations=imu.accelerations[keep],
        temperature=temperature,
    )
    return fresh, [*warnings, warning]


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

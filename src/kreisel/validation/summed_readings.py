"""Readings that are sums over the samples lost before them: sensors that keep increments until they are read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.recording.location import at
from kreisel.recording.recording import DataWarning, ImuSamples

_MOST = 10
"""Samples that one reading stands for at most. Chosen: within ten samples neighbours still resemble each other."""

_OFF = 0.2
"""Share of an interval by which a step may differ from a whole number of intervals. Chosen: jitter of most loggers."""

_LEAST = 3
"""Readings after lost samples from which it is judged. Chosen: one may be a fault of its own."""

_CLEAR = 0.1
"""Squares that sums of the neighbours leave, of those that their mean leaves. Chosen: at rest gravity alone makes it
zero; where readings are no sums, it is above one."""


def without_sums(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with each sum divided among the samples it stands for, and the warning about it.

    A device that puts out angle and velocity increments since the last time it was read loses nothing with a message
    that does not arrive: the next one holds more. As a rate over one interval it is too large, once.
    """
    steps = np.diff(imu.stamps_ns)
    usual = float(np.median(steps))
    if steps.max() < 1.5 * usual:
        return imu, []
    steps = steps / usual
    count = np.round(steps).astype(np.int64)
    even = np.abs(steps - count) < _OFF
    single = even & (count == 1)
    place = np.flatnonzero(even[1:-1] & (count[1:-1] > 1) & (count[1:-1] <= _MOST) & single[:-2] & single[2:]) + 2
    number = count[place - 1]
    summed = [_are_sums(values, place, number) for values in (imu.rates, imu.accelerations)]
    if not any(summed):
        return imu, []
    return _divided(imu, place, number, summed), [_warning(imu, place, summed)]


def _are_sums(values: Array, place: Indices, number: Indices) -> bool:
    """Return whether readings at places are as large as the mean of their neighbours, times a number, instead of once.

    Parameters
    ----------
    values : (n, 3)
        Readings of one sensor.
    place, number : (m,)
        Readings after lost samples, and how many samples each would stand for.
    """
    if place.size < _LEAST:
        return False
    usual = 0.5 * (values[place - 1] + values[place + 1])
    as_sums, as_usual = (
        float(np.sum((values[place] - times[:, None] * usual) ** 2)) for times in (number, np.ones_like(number))
    )
    return as_sums < _CLEAR * as_usual


def _divided(imu: ImuSamples, place: Indices, number: Indices, summed: list[bool]) -> ImuSamples:
    """Return the samples with the lost ones put in: mean values of sums, and straight lines between other readings."""
    repeats = np.ones(imu.stamps_ns.size, dtype=np.int64)
    repeats[place] = number
    source = np.repeat(np.arange(repeats.size), repeats)
    ends = np.cumsum(repeats) - 1
    stamps = np.interp(np.arange(source.size), ends, imu.stamps_ns - imu.stamps_ns[0])
    new = imu.stamps_ns[0] + np.round(stamps).astype(np.int64)
    new[ends] = imu.stamps_ns

    def filled(values: Array, *, sums: bool) -> Array:
        if not sums:
            return np.column_stack([np.interp(np.arange(source.size), ends, column) for column in values.T])
        return np.asarray(values[source] / repeats[source, None])

    warmth = imu.temperature
    return replace(
        imu,
        stamps_ns=new,
        rates=filled(imu.rates, sums=summed[0]),
        accelerations=filled(imu.accelerations, sums=summed[1]),
        temperature=None if warmth is None else warmth[source],
        rows=np.asarray(np.arange(repeats.size) if imu.rows is None else imu.rows)[source],
    )


def _warning(imu: ImuSamples, place: Indices, summed: list[bool]) -> DataWarning:
    what = " and ".join(name for name, sums in zip(("rates", "accelerations"), summed, strict=True) if sums)
    first = at(imu.source, imu.row_of(int(place[0])))
    return DataWarning(
        "sums",
        f"{imu.source.parent.name}: {place.size} {what} after lost samples, the first at {first}, are sums over the "
        "interval since the sample before, as of a sensor that keeps its increments until they are read; each was "
        "divided among the samples that it stands for",
    )

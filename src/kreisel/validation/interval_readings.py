"""Rates and accelerations that somebody made of increments, with another interval than the one they were taken over.

An increment over the nominal interval is a rate only if the interval is the nominal one. And counters that are read
evenly, divided by differences of the stamps of their arrival, scatter as these do.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, ImuSamples

_SCATTER = 3e-3
"""Standard deviation of intervals, over their mean, below which it does not matter over which readings were taken."""

_LONG = 1.8
"""Intervals from which a step is not one of those that scatter: samples are missing in it."""

_LAGS = (1, 8)
"""Distance of a reading and those it is compared with, samples. Chosen: two timers in turn show between neighbours,
intervals that change within some tenths of a second between samples that are further apart."""

_ALIKE = 2e-3
"""Share of an interval within which others are the same. Chosen: a timer varies by less, a scheduler by more."""

_MOST = 0.6
"""Share of the intervals that are the same from which theirs is the nominal one: of two timers, either has half."""

_MANY = 20_000
"""Readings that are compared. Chosen: the squares are then known to a few per cent."""

_CLEAR = 0.5
"""Squares that another interval leaves, of those that readings leave as they are. Chosen: 0.4 or less in six recordings
of increments, 0.97 or more in six of rates with stamps that scatter by 1 to 7 %."""


class _Over(Enum):
    """By what increments were divided."""

    NOMINAL = "the nominal interval instead of the one since the sample before"
    ARRIVAL = "differences of stamps that are not the moments of sampling"


def with_own_intervals(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples with increments divided by the interval they were taken over, and the warning about it.

    Where it is the one between the stamps, these are moved so that readings lie in the middle of their intervals, as
    those of the nominal length do; otherwise the stamps stay.
    """
    steps = np.diff(imu.stamps_ns).astype(np.float64)
    if imu.stamps_ns.size < 3 * max(_LAGS) or steps.min() <= 0.0:
        return imu, []
    steps = np.concatenate([[np.inf], steps])
    mean = float(np.median(steps))
    for _ in range(2):  # of two intervals in turn the median is one
        single = steps < _LONG * mean
        mean = float(steps[single].mean())
    if np.std(steps[single]) < _SCATTER * mean:
        return imu, []
    longer = np.where(single, steps / mean, 1.0)
    t = (imu.stamps_ns - imu.stamps_ns[0]) / mean
    found = {name: _divided_by(values, t, longer) for name, values in _sensors(imu).items()}
    if not any(found.values()):
        return imu, []
    nominal = _nominal(steps[single]) / mean
    factor = {None: np.ones((1, 1)), _Over.NOMINAL: nominal / longer[:, None], _Over.ARRIVAL: longer[:, None]}
    factor[_Over.NOMINAL][~single] = 1.0
    changed = {name: values * factor[found[name]] for name, values in _sensors(imu).items()}
    stamps = imu.stamps_ns
    if _Over.NOMINAL in found.values():
        stamps = stamps - np.round(0.5 * mean * (longer - 1.0)).astype(np.int64)
    return replace(imu, stamps_ns=stamps, **changed), [_warning(imu, found, float(np.std(longer[single])))]


def _nominal(steps: Array) -> float:
    """Return the interval by which a device divides increments: that of most samples, or the mean without one."""
    usual = float(np.median(steps))
    return usual if np.mean(np.abs(steps - usual) < _ALIKE * usual) > _MOST else float(steps.mean())


def _sensors(imu: ImuSamples) -> dict[str, Array]:
    return {"rates": imu.rates, "accelerations": imu.accelerations}


def _divided_by(values: Array, t: Array, longer: Array) -> _Over | None:
    """Return by what the increments of a sensor were divided; None where they are rates.

    Parameters
    ----------
    values : (n, 3)
        Readings.
    t : (n,)
        Stamps, in mean intervals.
    longer : (n,)
        Interval since the sample before, over the mean one.
    """
    even = np.arange(t.size, dtype=np.float64)
    ways = {
        _Over.NOMINAL: (values / longer[:, None], t - 0.5 * longer),
        _Over.ARRIVAL: (values * longer[:, None], even),
    }
    for lag in _LAGS:
        usual = min(squares_left(values, at, lag) for at in (t, even))
        for way, (changed, at) in ways.items():
            if squares_left(changed, at, lag) < _CLEAR * usual:
                return way
    return None


def squares_left(values: Array, t: Array, lag: int = 1) -> float:
    """Return squares of values (n, 3) at times (n,), less straight lines between those some samples away, added up."""
    count = t.size - 2 * lag
    k = lag + np.arange(min(count, _MANY)) * (count - 1) // max(min(count, _MANY) - 1, 1)
    share = ((t[k] - t[k - lag]) / (t[k + lag] - t[k - lag]))[:, None]
    return float(np.sum((values[k] - (1.0 - share) * values[k - lag] - share * values[k + lag]) ** 2))


def _warning(imu: ImuSamples, found: dict[str, _Over | None], scatter: float) -> DataWarning:
    of = {name: way for name, way in found.items() if way is not None}
    by = " and ".join(dict.fromkeys(way.value for way in of.values()))
    return DataWarning(
        "intervals",
        f"{imu.source.parent.name}: {' and '.join(of)} are increments that were divided by {by}; intervals scatter by "
        f"{100.0 * scatter:.2g} %, and so did the readings; corrected",
    )

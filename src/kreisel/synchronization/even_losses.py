"""Samples lost at even intervals: of a sensor that measures a little faster than it is asked for readings.

Some of these losses show by the reference, those at rest do not. Where the former lie on a comb, all others are on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.recording import Stamps
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.lost_samples import LostSamples
from kreisel.validation.stamp_checks import runs

_FEWEST, _MOST = 3, 0.8
"""Losses that were found from which on combs are looked for, and share of them that must lie on one."""

_SHORTEST, _COMBS = 4.0, 16
"""s: least period, and most combs that are tried, those with the longest periods. Chosen: by shorter periods too much
of a recording lies near a tooth to be used."""

_BESIDE = 0.1
"""s: what the place of a loss may be off beyond where it lies for sure."""

_SURE = 3.0
"""Deviations of a tooth's place between which it lies."""


def evenly_lost(found: LostSamples, stamps_ns: Stamps, clock: Clock) -> list[LostSamples]:
    """Return losses at every tooth of the combs on which those found lie, one for each comb.

    Which is right, if any, is seen by what it leaves of the differences to the reference.

    Parameters
    ----------
    found
        With the interval of counted stamps.
    stamps_ns : (n,)
        Counted stamps of all readings.
    clock
        By these stamps.
    """
    if found.places.size < _FEWEST:
        return []
    windows = clock.imu_time(found.unsure) + np.array([-_BESIDE, _BESIDE])
    low, high = windows.T
    whole = 1e-9 * float(stamps_ns[-1] - stamps_ns[0])
    step = 0.2 * float(np.median(high - low)) / whole
    periods = np.exp(np.arange(np.log(_SHORTEST), np.log(max(whole / _FEWEST, _SHORTEST)), step))
    number = np.array([_most_on(float(period), low, high)[0] for period in periods])
    begin, end = runs(number >= max(_FEWEST, _MOST * len(windows)))
    middle = [float(np.median(periods[a:b][number[a:b] == number[a:b].max()])) for a, b in zip(begin, end, strict=True)]
    combs = [_comb(period, low, high, whole) for period in sorted(middle, reverse=True)[:_COMBS]]
    return [_at_teeth(found, *comb, stamps_ns.size, clock) for comb in combs if comb is not None]


def _comb(period: float, low: Array, high: Array, whole: float) -> tuple[Array, Array, float] | None:
    """Return the teeth of the comb of about a period that fits most windows, their deviations, and its period.

    None where too few teeth have losses: those about one moment are on every comb.
    """
    phase = _most_on(period, low, high)[1]
    middle, width = 0.5 * (low + high), high - low
    tooth = np.round((middle - phase) / period)
    on = np.abs(middle - phase - period * tooth) <= 0.5 * width + _BESIDE
    if np.unique(tooth[on]).size < _FEWEST:
        return None
    (slope, first), covariance = np.polyfit(tooth[on], middle[on], 1, w=12**0.5 / width[on], cov="unscaled")
    number = np.arange(np.ceil(-first / slope), np.floor((whole - first) / slope) + 1.0)
    sd = np.sqrt(covariance[1, 1] + 2.0 * number * covariance[0, 1] + number**2 * covariance[0, 0])
    return first + slope * number, sd, float(slope)


def _at_teeth(found: LostSamples, teeth: Array, sd: Array, period: float, count: int, clock: Clock) -> LostSamples:
    """Return losses at the teeth of a comb, IMU seconds; count: of all readings."""
    at = np.clip(np.round(1e9 * teeth / found.interval_ns), 1, count - 1).astype(np.int64)
    beside = _SURE * sd + _BESIDE
    between = clock.reference_time(np.column_stack([teeth - beside, teeth + beside]))
    return replace(found, places=at, counts=np.ones_like(at), unsure=between, faster=1e-9 * found.interval_ns / period)


def _most_on(period: float, low: Array, high: Array) -> tuple[int, float]:
    """Return the most places on a comb of a period, and the middle of the phases that they have in common."""
    begin, size = np.mod(low, period), high - low
    edges = np.concatenate([begin, begin + size, begin + period, begin + size + period])
    change = np.repeat([1, -1, 1, -1], low.size)
    order = np.lexsort((-change, edges))
    inside = np.cumsum(change[order])
    k = int(np.argmax(inside))
    if np.any(size >= period):
        return 0, 0.0
    return int(inside[k]), float(edges[order][k : k + 2].mean())

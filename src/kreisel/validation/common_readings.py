"""How many readings two recordings have in common: copies, parts of one another, logs that overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Mask
from kreisel.recording.recording import ImuSamples

_ROWS = 16
"""Successive readings that are compared as one. Chosen: of coarse steps, fewer are the same by chance."""

_DIFFERENT = 8
"""Readings of these that differ from the one before at least: a sensor at rest may repeat itself."""


def share_in_common(one: ImuSamples, other: ImuSamples) -> float:
    """Return the share of the shorter of two recordings whose readings are in the longer one, in the same order."""
    short, long = sorted((one, other), key=lambda imu: imu.stamps_ns.size)
    found, changing = _fingerprints(short)
    if not changing.any():
        return 0.0
    return float(np.isin(found[changing], _fingerprints(long)[0]).mean())


def _fingerprints(imu: ImuSamples) -> tuple[NDArray[np.uint64], Mask]:
    """Return a number for each `_ROWS` successive readings, and whether these change."""
    values = np.ascontiguousarray(np.hstack([imu.rates, imu.accelerations]) + 0.0).view(np.uint64)
    rng = np.random.default_rng(1)
    columns, places = (rng.integers(1, 2**63, size, dtype=np.uint64) | np.uint64(1) for size in (6, _ROWS))
    rows = (values ^ (values >> np.uint64(29))) @ columns
    rows ^= rows >> np.uint64(31)
    n = rows.size - _ROWS + 1
    if n < 1:
        return np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=bool)
    sums = np.zeros(n, dtype=np.uint64)
    for k, place in enumerate(places):
        sums += rows[k : k + n] * place
    steps = np.concatenate([[0], np.cumsum(rows[1:] != rows[:-1])])
    return sums, steps[_ROWS - 1 :] - steps[:n] >= _DIFFERENT

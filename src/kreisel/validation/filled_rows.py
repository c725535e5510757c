"""Rows that a program put in on straight lines where samples were missing: they say nothing, and hide the gap."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.recording.location import at
from kreisel.recording.recording import DataWarning, ImuSamples
from kreisel.validation.masking import part_of
from kreisel.validation.sampling import MIN_PART
from kreisel.validation.stamp_checks import runs

_MANY = 20_000
"""Readings that are looked at first, spread evenly."""

_STRAIGHT, _BY_CHANCE = 1e-3, 0.01
"""Second difference, over the median one, below which a reading lies on a line with its neighbours; share of samples of
which noise makes one channel so, at most. Chosen: it is 5e-4, and six channels are all so in one of 10^18 samples."""

_LEAST = 3
"""Rows in a place from which they are filled in."""


def without_filled(imu: ImuSamples) -> tuple[ImuSamples, list[DataWarning]]:
    """Return the samples without rows that lie on straight lines in all six channels, and the warning about them.

    Of a sensor without noise, or in steps so coarse that most second differences are zero, nothing is left out.
    """
    if imu.stamps_ns.size < MIN_PART:
        return imu, []
    some = _second_differences(imu, max(1, imu.stamps_ns.size // _MANY))
    usual = np.median(some, axis=0)
    small = some < _STRAIGHT * usual
    others = small[~small.all(axis=1)]
    if not usual.all() or len(others) == len(small) or not len(others) or others.mean(axis=0).max() > _BY_CHANCE:
        return imu, []
    filled = _straight(imu, usual)
    if not filled.any():
        return imu, []
    first = at(imu.source, imu.row_of(int(np.argmax(filled))))
    text = (
        f"{imu.source.parent.name}: {int(filled.sum())} samples in {runs(filled)[0].size} places, the first at {first}"
        ", lie on straight lines in all channels, as where missing ones are filled in; left out"
    )
    return part_of(imu, ~filled), [DataWarning("lost", text)]


def _second_differences(imu: ImuSamples, every: int = 1) -> Array:
    """Return the sizes of second differences about every so-many-th sample but the first and last, (m, 6)."""
    sensors = (imu.rates, imu.accelerations)
    return np.abs(np.hstack([x[:-2:every] - 2.0 * x[1:-1:every] + x[2::every] for x in sensors]))


def _straight(imu: ImuSamples, usual: Array) -> Mask:
    """Return which samples (n,) lie on a line with their neighbours, some of them in a row."""
    mask = np.zeros(imu.stamps_ns.size, dtype=bool)
    mask[1:-1] = (_second_differences(imu) < _STRAIGHT * usual).all(axis=1)
    for begin, end in zip(*runs(mask), strict=True):
        across = np.concatenate([x[end] - x[begin - 1] for x in (imu.rates, imu.accelerations)])
        changed = np.abs(across) > _STRAIGHT * usual
        mask[begin:end] = end - begin >= _LEAST and changed.all()
    return mask

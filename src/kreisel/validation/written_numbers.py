"""Numbers that a program wrote wrongly with whole parts and fractions of their own, as by `printf("%d.%d", …)`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.recording.location import header_fault
from kreisel.recording.recording import ImuSamples
from kreisel.validation.masking import CHANNELS

_MANY = 20_000
"""Readings that are looked at first, spread evenly."""

_HOLE, _BESIDE, _DIFFERENT = 50, 30, 10
"""Readings above zero that have no counterpart below, those next to them that have, and different values of the former.
Chosen: by chance less than one in 10^9, if readings on both sides are about as frequent; a converter leaves one."""

_FRACTIONS = 200
"""Different fractions from which a tenth of them begins with a zero."""

_DIGITS = 10.0 ** np.arange(1, 6)
"""What the fraction of a reading that lost one to five zeros is too large by."""

_CLEAR, _PASSES = 4.0, 5
"""Ratio of distances from what the two readings before continue to, beyond which one way to read a number is the right
one; and passes at which that is the other way: as many, and more than those where it is the number as it stands.
Chosen: a reading at rest, or after a pause, continues neither way; four passes or fewer are no proof."""


def check_written(imu: ImuSamples) -> None:
    """Raise an error if numbers have lost the sign of a whole part of zero, or zeros after the decimal point.

    Values that do not occur are not enough: a sensor at rest in a few attitudes has large holes. The signal has to pass
    through the values, and to continue evenly with numbers read the other way.

    Raises
    ------
    RecordingError
        With the channel, and how to write them.
    """
    every = max(1, imu.stamps_ns.size // _MANY)
    sizes = [imu.units.size("rate")] * 3 + [imu.units.size("acceleration")] * 3
    columns = [*imu.rates.T, *imu.accelerations.T]
    for name, column, size in zip(CHANNELS, columns, sizes, strict=True):
        text = _without_sign(column, every) or _without_zeros(column, size, every)
        if text is not None:
            raise header_fault(imu.source, f"{name}: {text}")


def _without_sign(values: Array, every: int) -> str | None:
    """Return what is wrong if no reading lies just below zero, though many lie just above, and further below."""
    looked_at = values[::every]
    below = looked_at[looked_at < 0.0]
    if below.size < _BESIDE:
        return None
    hole = float(-below.max())
    above, beside = looked_at[(looked_at > 0.0) & (looked_at < hole)], int(np.sum(below > -2.0 * hole))
    if above.size < _HOLE or beside < _BESIDE or np.unique(above).size < _DIFFERENT:
        return None

    def passes(x: Array) -> tuple[Indices, Array]:
        at = np.flatnonzero((x[:-2] < 0.0) & (x[1:-1] < 0.0) & (x[2:] > 0.0) & (x[2:] < hole)) + 2
        return at, -x[at, None]

    if not _continues(values, passes):
        return None
    return (
        f"no reading lies between {-hole:.3g} and 0, though {above.size} of {looked_at.size} lie between 0 and "
        f"{hole:.3g}: numbers with a whole part of zero have lost their sign, as if whole parts and fractions were "
        "written one by one; write them as one number"
    )


def _without_zeros(values: Array, unit: float, every: int) -> str | None:
    """Return what is wrong if no fraction begins with a zero, though there are many of all others."""
    looked_at = values[::every] / unit
    fractions = np.unique(np.round(np.abs(looked_at) % 1.0, 6))
    small, others = fractions[(fractions > 0.0) & (fractions < 0.1)], fractions[fractions >= 0.1]
    if small.size or others.size < _FRACTIONS or np.ptp(looked_at) < 2.0:
        return None

    def passes(x: Array) -> tuple[Indices, Array]:
        whole = np.floor(x)
        at = np.flatnonzero((x[:-2] > 0.0) & (whole[:-2] == whole[1:-1]) & (whole[2:] == whole[1:-1] + 1.0)) + 2
        return at, whole[at, None] + (x[at] - whole[at])[:, None] / _DIGITS

    if not _continues(np.abs(values) / unit, passes):
        return None
    return (
        f"of {others.size} different fractions none begins with a zero: 1.05 was written as 1.5, as if whole parts and "
        "fractions were written one by one without zeros in front; write them as one number"
    )


def _continues(values: Array, passes: Callable[[Array], tuple[Indices, Array]]) -> bool:
    """Return whether readings, read in other ways, continue those before them, and as they stand do not.

    passes: returns the places (m,) after two readings that are right, and what else is meant there, (m, k).
    """
    other = as_it_stands = 0
    for x in (values, values[::-1]):
        at, meant = passes(x)
        expected = 2.0 * x[at - 1] - x[at - 2]
        own, best = np.abs(x[at] - expected), np.abs(meant - expected[:, None]).min(axis=1, initial=np.inf)
        other += int(np.sum(own > _CLEAR * best))
        as_it_stands += int(np.sum(best > _CLEAR * own))
    return other >= _PASSES and other > as_it_stands

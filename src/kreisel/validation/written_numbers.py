"""Numbers that a program wrote wrongly with whole parts and fractions of their own, as by `printf("%d.%d", …)`."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.location import header_fault
from kreisel.recording.recording import ImuSamples
from kreisel.validation.masking import CHANNELS

_MANY = 20_000
"""Readings that are looked at, spread evenly."""

_HOLE, _BESIDE, _DIFFERENT = 50, 30, 10
"""Readings above zero that have no counterpart below, those next to them that have, and different values of the former.
Chosen: by chance less than one in 10^9, if readings on both sides are about as frequent; a converter leaves one."""

_FRACTIONS = 200
"""Different fractions from which a tenth of them begins with a zero."""


def check_written(imu: ImuSamples) -> None:
    """Raise an error if numbers have lost the sign of a whole part of zero, or zeros after the decimal point.

    Raises
    ------
    RecordingError
        With the channel, and how to write them.
    """
    every = max(1, imu.stamps_ns.size // _MANY)
    sizes = [imu.units.size("rate")] * 3 + [imu.units.size("acceleration")] * 3
    columns = [*imu.rates[::every].T, *imu.accelerations[::every].T]
    for name, column, size in zip(CHANNELS, columns, sizes, strict=True):
        text = _without_sign(column) or _without_zeros(column / size)
        if text is not None:
            raise header_fault(imu.source, f"{name}: {text}")


def _without_sign(values: Array) -> str | None:
    """Return what is wrong if no reading lies just below zero, though many lie just above, and further below."""
    below = values[values < 0.0]
    if below.size < _BESIDE:
        return None
    hole = float(-below.max())
    above, beside = values[(values > 0.0) & (values < hole)], int(np.sum(below > -2.0 * hole))
    if above.size < _HOLE or beside < _BESIDE or np.unique(above).size < _DIFFERENT:
        return None
    return (
        f"no reading lies between {-hole:.3g} and 0, though {above.size} of {values.size} lie between 0 and "
        f"{hole:.3g}: numbers with a whole part of zero have lost their sign, as if whole parts and fractions were "
        "written one by one; write them as one number"
    )


def _without_zeros(values: Array) -> str | None:
    """Return what is wrong if no fraction begins with a zero, though there are many of all others."""
    fractions = np.unique(np.round(np.abs(values) % 1.0, 6))
    small, others = fractions[(fractions > 0.0) & (fractions < 0.1)], fractions[fractions >= 0.1]
    if small.size or others.size < _FRACTIONS or np.ptp(values) < 2.0:
        return None
    return (
        f"of {others.size} different fractions none begins with a zero: 1.05 was written as 1.5, as if whole parts and "
        "fractions were written one by one without zeros in front; write them as one number"
    )

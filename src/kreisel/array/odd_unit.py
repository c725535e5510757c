"""The unit whose corrected readings differ from those of the others: dead axes, offsets that changed, another unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.common_motion import averaged
from kreisel.geometry.rotation import Array

_ROW = 0.1
"""s of a mean. Chosen: noise of cheap units is then a thousandth of their range, and slow errors are whole."""

_FAR = (3e-3, 0.1)
"""Differences of rates, rad/s, and of forces, m/s^2, rms, from which a unit may be odd. Chosen: offsets of consumer
devices change by as much from one day to the next."""

_ODD = 4.0
"""The same over those of most others. Chosen: of units of one make, offsets change by one size."""


@dataclass(frozen=True)
class OddUnit:
    """The number of a unit, and how far its rates, rad/s, or forces, m/s^2, are from the median of all, rms."""

    number: int
    sensor: int
    size: float

    @property
    def text(self) -> str:
        """What is said of it."""
        what, unit = (("rates", "rad/s"), ("forces", "m/s^2"))[self.sensor]
        return (
            f"its corrected {what} differ from those of the others by {self.size:.2g} {unit} rms: an axis fails, its "
            "offsets changed since the calibration, or it is another unit"
        )


def odd_unit(rates: Array, forces: Array, interval: float) -> OddUnit | None:
    """Return the unit that differs most from the median of three or more, if it stands out.

    Parameters
    ----------
    rates, forces : (N, n, 3)
        Corrected, in common axes and at a common place.
    interval
        Between samples, s.
    """
    if len(rates) < 3:
        return None
    width = max(1, round(_ROW / interval))
    found: list[tuple[float, OddUnit]] = []
    for sensor, values in enumerate((rates, forces)):
        rows = np.stack([averaged(own, width) for own in values])
        size = np.sqrt(np.mean(np.sum((rows - np.median(rows, axis=0)) ** 2, axis=2), axis=1))
        number = int(np.argmax(size))
        others = float(np.median(np.delete(size, number)))
        if size[number] > max(_FAR[sensor], _ODD * others):
            found.append((size[number] / _FAR[sensor], OddUnit(number, sensor, float(size[number]))))
    return max(found, key=lambda one: one[0])[1] if found else None

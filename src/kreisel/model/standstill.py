"""Standstill: when the IMU stands still, and the intervals in which reference and IMU both stand still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.earth import EARTH_RATE


@dataclass(frozen=True)
class Standstill:
    """An interval of standstill: IMU seconds, without the margins."""

    start: float
    stop: float


@dataclass(frozen=True)
class ImuStillness:
    """Times a tenth of a window apart, IMU seconds (k,), and whether the IMU stands still around them."""

    seconds: Array
    still: Mask


@dataclass(frozen=True)
class OutsideStandstill:
    """Standstill the IMU recorded before the reference began or after it ended.

    Attributes
    ----------
    rate : (3,)
        Mean reading of the gyros, rad/s.
    seconds
        How long it lasted.
    """

    rate: Array
    seconds: float

    def deviation(self, density: Array) -> Array:
        """Return the standard deviation of the rate as the gyros' offset, (3,).

        Parameters
        ----------
        density : (3,)
            Noise density of the gyros. The Earth's rate, of unknown direction here, is an error too; twice
            the sum is taken, because offsets drift.
        """
        return np.asarray(2.0 * np.sqrt(density**2 / self.seconds + EARTH_RATE**2))

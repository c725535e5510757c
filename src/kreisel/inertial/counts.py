"""Raw converter readings, and nominal sensitivities that make quantities of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Counts:
    """What a count is, nominally: quantity = (count - zero) * size. The calibration's K corrects that.

    Attributes
    ----------
    rate, acceleration
        Size of a count, rad/s and m/s^2; 1 where readings are quantities already.
    rate_zero, acceleration_zero : (3,)
        Counts at nothing: half of the range of converters that know no sign.
    """

    rate: float
    acceleration: float
    rate_zero: Array
    acceleration_zero: Array

    def in_si(self, rates: Array, accelerations: Array) -> tuple[Array, Array]:
        """Return nominal rates and accelerations, (n, 3) each, of counts."""
        return (
            np.asarray((rates - self.rate_zero) * self.rate),
            np.asarray((accelerations - self.acceleration_zero) * self.acceleration),
        )

"""Gravity and the Earth's rotation at the place of the cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, matrix
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.parameters import CellParameters

EARTH_SD = 3**-0.5
"""Deviation of each component of a vector of unit length and unknown direction."""


@dataclass(frozen=True)
class Site:
    """Gravity (m/s^2) with its standard deviation, and the Earth's rotation.

    Attributes
    ----------
    earth_rate_n : (3,) or None
        In north, east, down, rad/s; None where no latitude is given: it is then estimated.
    """

    gravity: float
    gravity_sd: float
    earth_rate_n: Array | None

    @property
    def earth_rate_units(self) -> tuple[float, float]:
        """Earth rate, rad/s, for a unit of each of the parameters `north` and `earth_down`."""
        if self.earth_rate_n is None:
            return EARTH_RATE, EARTH_RATE
        return float(self.earth_rate_n[0]), float(self.earth_rate_n[2])

    @property
    def known_earth_down(self) -> float:
        """Value of `earth_down` before any look at the data: 1 by the latitude, 0 without one."""
        return 0.0 if self.earth_rate_n is None else 1.0


def gravity_r(parameters: CellParameters) -> Array:
    """Return gravity in r, (3,), m/s^2."""
    return matrix(parameters.q_rn)[:, 2] * parameters.gravity


def north_r(parameters: CellParameters) -> Array:
    """Return north in r, (3,), a level vector; its estimated length is one within its uncertainty."""
    return matrix(parameters.q_rn)[:, :2] @ parameters.north


def earth_rate_r(site: Site, parameters: CellParameters) -> Array:
    """Return the Earth's rotation in r, (3,), rad/s, where it is estimated."""
    level, down = site.earth_rate_units
    return matrix(parameters.q_rn) @ np.array([*(level * parameters.north), down * parameters.earth_down])

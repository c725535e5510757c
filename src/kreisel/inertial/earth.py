"""Gravity and rotation of the Earth."""

from __future__ import annotations

import math

import numpy as np

from kreisel.geometry.rotation import Array

EARTH_RATE = 7.292115e-5
"""rad/s; WGS 84 (NIMA TR8350.2, third edition, table 3.1)."""

_GAMMA_EQUATOR = 9.7803253359  # m/s^2, TR8350.2 table 3.4
_SOMIGLIANA_K = 0.00193185265241  # of Somigliana's formula, TR8350.2 table 3.4
_ECCENTRICITY_SQUARED = 6.69437999014e-3  # first eccentricity squared, TR8350.2 table 3.3
_SEMI_MAJOR_AXIS = 6378137.0  # m, TR8350.2 table 3.1
_FLATTENING = 1.0 / 298.257223563  # TR8350.2 table 3.1
_M = 0.00344978650684  # omega^2 a^2 b / GM, TR8350.2 table 3.4
"""WGS 84 (NIMA TR8350.2, third edition)."""


def normal_gravity(latitude: float, height: float = 0.0) -> float:
    """Return the magnitude of normal gravity in m/s^2.

    Parameters
    ----------
    latitude
        Geodetic latitude, rad.
    height
        Height above the ellipsoid, m; the series is good to 1e-7 m/s^2 below 10 km.

    Notes
    -----
    Somigliana's closed form on the WGS 84 ellipsoid, NIMA TR8350.2, equations (4-1) and (4-3).
    """
    s2 = math.sin(latitude) ** 2
    surface = _GAMMA_EQUATOR * (1.0 + _SOMIGLIANA_K * s2) / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * s2)
    a = _SEMI_MAJOR_AXIS
    return surface * (
        1.0 - 2.0 / a * (1.0 + _FLATTENING + _M - 2.0 * _FLATTENING * s2) * height + 3.0 * (height / a) ** 2
    )


def earth_rate_n(latitude: float) -> Array:
    """Return the Earth's rotation rate (3,) in north, east, down at a geodetic latitude in rad, rad/s."""
    return EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])

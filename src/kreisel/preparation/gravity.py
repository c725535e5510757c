"""Gravity and the Earth's rotation where a recording was made, by its settings.

A stated value has an uncertainty of its own: a latitude without a height leaves gravity uncertain, and a stated
value of gravity is often copied from a table.
"""

from __future__ import annotations

import math

from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.model.site import Site
from kreisel.recording.recording import DataWarning
from kreisel.recording.recording_settings import SiteTable
from kreisel.units import STANDARD_GRAVITY

UNKNOWN_SD = 0.015
"""m/s^2; spread of gravity over the inhabited Earth about standard gravity."""

HEIGHT, HEIGHT_SD = 500.0, 1100.0
"""m; height of a place of which only the latitude is known. Most people live below 500 m, but La Paz lies at 3640 m."""

ANOMALY_SD = 3e-4
"""m/s^2; spread of gravity about its normal value at a known latitude and height (free-air anomalies)."""

ROUNDED_SD = 1e-3
"""m/s^2; uncertainty of a value stated to three digits after the point."""

CONTRADICTION = 4.0
"""Standard deviations by which a stated value may differ from the one by the latitude."""

NO_LATITUDE = DataWarning(
    "site", "no latitude is given: the Earth's rotation is estimated (site.latitude_deg states it)"
)
"""A warning about the Earth's rotation; all others are about gravity."""

_TEXTBOOK = {"9.80665", "9.8066", "9.8067", "9.807", "9.806"}
_FREE_AIR = 3.086e-6  # 1/s^2, change of gravity with height


def site_of(table: SiteTable) -> tuple[Site, list[DataWarning]]:
    """Return gravity and Earth rate at a site, and the warnings about them."""
    rate = None if table.latitude_deg is None else earth_rate_n(math.radians(table.latitude_deg))
    value, sd, warnings = _gravity(table)
    if rate is None:
        warnings.append(NO_LATITUDE)
    return Site(value, sd, rate), warnings


def _gravity(table: SiteTable) -> tuple[float, float, list[DataWarning]]:
    """Return gravity, its standard deviation, and the warnings about it."""
    by_latitude = _by_latitude(table)
    if table.gravity is None:
        if by_latitude is None:
            return STANDARD_GRAVITY, UNKNOWN_SD, []
        return by_latitude[0], table.gravity_sd or by_latitude[1], []
    sd = table.gravity_sd or _stated_sd(table.gravity)
    if by_latitude is None:
        return table.gravity, sd, _textbook_warning(table)
    normal, normal_sd = by_latitude
    difference = table.gravity - normal
    if abs(difference) > CONTRADICTION * math.hypot(sd, normal_sd):
        message = (
            f"gravity is stated as {table.gravity:g} m/s^2, but the latitude gives {normal:.4f} ± {normal_sd:.1g}; a "
            f"standard deviation of {abs(difference):.2g} m/s^2 is used: correct one of the two in recording.toml"
        )
        return table.gravity, abs(difference), [DataWarning("site", message)]
    if sd <= normal_sd:
        return table.gravity, sd, []
    return normal, normal_sd, _textbook_warning(table, instead=normal)


def _by_latitude(table: SiteTable) -> tuple[float, float] | None:
    """Return normal gravity and its standard deviation, or None where no latitude is given."""
    if table.latitude_deg is None:
        return None
    latitude = math.radians(table.latitude_deg)
    if table.height_m is None:
        return normal_gravity(latitude, HEIGHT), math.hypot(_FREE_AIR * HEIGHT_SD, ANOMALY_SD)
    return normal_gravity(latitude, table.height_m), ANOMALY_SD


def _stated_sd(gravity: float) -> float:
    """Return the uncertainty of a stated value of gravity, as its digits suggest."""
    digits = repr(gravity)
    after = len(digits.partition(".")[2])
    if digits in _TEXTBOOK or after < 3:
        return UNKNOWN_SD
    return ROUNDED_SD if after == 3 else ANOMALY_SD


def _textbook_warning(table: SiteTable, instead: float | None = None) -> list[DataWarning]:
    """Return the warning about a stated value that is not a measurement."""
    if table.gravity_sd is not None or table.gravity is None or _stated_sd(table.gravity) < UNKNOWN_SD:
        return []
    used = (
        f"a standard deviation of {UNKNOWN_SD} m/s^2 is used" if instead is None
        else f"{instead:.4f} m/s^2, from the latitude, is used"
    )  # fmt: skip
    message = f"the stated gravity {table.gravity:g} m/s^2 looks like a textbook value, not one of this place; {used}"
    return [DataWarning("site", f"{message} (site.gravity_sd states its standard deviation)")]

"""Units of the columns of a table: those that are read, and those that a header states."""

from __future__ import annotations

import re
from dataclasses import dataclass

from kreisel.units import DEG, STANDARD_GRAVITY

UNITS: dict[str, dict[str, float]] = {
    "time": {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9},
    "rate": {
        "rad s^-1": 1.0, "rad/s": 1.0, "rads^-1": 1.0, "deg s^-1": DEG, "deg/s": DEG, "°/s": DEG, "dps": DEG,
        "mdps": 1e-3 * DEG, "deg/h": DEG / 3600.0, "counts": 1.0, "LSB": 1.0,
    },
    "acceleration": {
        "m s^-2": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "ms^-2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY,
        "cm/s^2": 1e-2, "cm/s2": 1e-2, "mm/s^2": 1e-3, "mm/s2": 1e-3, "ft/s^2": 0.3048, "ft/s2": 0.3048,
        "counts": 1.0, "LSB": 1.0,
    },
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048},
    "quaternion": {"": 1.0, "-": 1.0, "1": 1.0},
    "angle": {"rad": 1.0, "deg": DEG},
    "temperature": {"degC": 1.0, "deg C": 1.0, "°C": 1.0, "C": 1.0, "K": 1.0},
}  # fmt: skip
"""Size of each unit in SI, by quantity; time in nanoseconds. The first unit is used where none is stated. That of a
converter's counts nobody knows: `kreisel static` finds it."""

COUNTED = ("counts", "LSB")
"""Units of raw converter readings."""


_INDEX = re.compile(r"\S\[\s*\d+\s*(,\s*\d+\s*)?\]\s*$")
_NAME_AND_UNIT = re.compile(r"^(.*?)\s*(\[[^\[\]]*\]|\([^()]*\))\s*$")
_LIKE_A_UNIT = re.compile(r"deg|rad|dps|sec|/|hz|°|^m?g$|^[munµ]?s$|^[cm]?m$", re.IGNORECASE)


def plain_unit(text: str) -> str:
    """Return a unit with single blanks, and u for micro."""
    return re.sub(r"\s+", " ", text.strip()).replace("\u00b5", "u").replace("\u03bc", "u")


def split_unit(text: str) -> tuple[str, str | None]:
    """Return name and unit of 'name [unit]' or 'name (unit)'; the unit is None where there is none.

    What is in parentheses belongs to the name if it does not look like a unit, and so does an index, as in q[0].
    """
    match = _NAME_AND_UNIT.match(text)
    if match is None or _INDEX.search(text):
        return text.strip(), None
    unit = plain_unit(match.group(2)[1:-1])
    known = any(unit in units for units in UNITS.values())
    if known or match.group(2).startswith("[") or _LIKE_A_UNIT.search(unit):
        return match.group(1).strip(), unit
    return text.strip(), None


COLDEST, HOTTEST = -80.0, 200.0
"""Degrees Celsius, of a sensor that works."""


@dataclass(frozen=True)
class HeaderUnits:
    """Units that a table's header states, each None where it states none, or where there is no header.

    Attributes
    ----------
    time, rate, acceleration, length, angle
        One of the `UNITS` of that quantity.
    """

    time: str | None = None
    rate: str | None = None
    acceleration: str | None = None
    length: str | None = None
    angle: str | None = None

    def size(self, quantity: str) -> float:
        """Return the factor that converted the numbers of a quantity to SI, or to nanoseconds."""
        stated = getattr(self, quantity)
        return 1.0 if stated is None else UNITS[quantity][stated]

    def counted(self, quantity: str) -> bool:
        """Return whether the numbers of a quantity are raw converter readings."""
        return getattr(self, quantity) in COUNTED


NO_UNITS = HeaderUnits()
"""Units of a stream that is in SI, as the messages of bags are."""


def named(quantity: str, size: float) -> str | None:
    """Return the unit of a quantity that has this size in SI, None where there is none."""
    return next((unit for unit, own in UNITS[quantity].items() if abs(own / size - 1.0) < 1e-3), None)

"""Units of the columns of a table: those that are read, and what a header states of a stream."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.units import DEG, STANDARD_GRAVITY

UNITS: dict[str, dict[str, float]] = {
    "time": {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9},
    "rate": {
        "rad s^-1": 1.0, "rad/s": 1.0, "rads^-1": 1.0, "deg s^-1": DEG, "deg/s": DEG, "°/s": DEG, "dps": DEG,
        "mdps": 1e-3 * DEG, "deg/h": DEG / 3600.0,
    },
    "acceleration": {
        "m s^-2": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "ms^-2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY,
    },
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "quaternion": {"": 1.0, "-": 1.0, "1": 1.0},
    "angle": {"rad": 1.0, "deg": DEG},
}  # fmt: skip
"""What one of each unit is in SI, by quantity; of time in nanoseconds. The first is the one taken without any."""


@dataclass(frozen=True)
class HeaderUnits:
    """Units a table's header states, each None where it states none, or where there is no header.

    Attributes
    ----------
    time, rate, acceleration, length, angle
        One of `UNITS` of that quantity.
    """

    time: str | None = None
    rate: str | None = None
    acceleration: str | None = None
    length: str | None = None
    angle: str | None = None

    def size(self, quantity: str) -> float:
        """Return what numbers of a quantity were multiplied by to be in SI, or in nanoseconds."""
        stated = getattr(self, quantity)
        return 1.0 if stated is None else UNITS[quantity][stated]


NO_UNITS = HeaderUnits()
"""Of what is in SI, as messages of bags are."""


def named(quantity: str, size: float) -> str | None:
    """Return the unit of a quantity that has a size in SI, None where there is no such."""
    return next((unit for unit, own in UNITS[quantity].items() if abs(own / size - 1.0) < 1e-3), None)

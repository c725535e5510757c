"""Channels of a robot's recorder: the meaning of their names, and their values in SI."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.units import DEG

Kind = Literal["measured", "commanded", "bare"]

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSITION = ("X", "Y", "Z")
ORIENTATION = ("A", "B", "C")

_MEASURED = {"act", "actual", "ist", "istposition", "istwert", "istwinkel", "mes", "meas", "measured"}
_COMMANDED = {"cmd", "command", "commanded", "soll", "sollposition", "sollwert", "sollwinkel", "setpoint", "target"}
_OF_AN_AXIS = {"axis", "achse", "joint", "istposition", "sollposition"}
_WITHOUT_MEANING = {"axis", "achse", "joint", "pos", "position", "cart", "kart", "tcp", "ipo", "krc"}
_WORD = re.compile(r"[A-Z]?[a-zäöüß]+|[A-Z]+(?![a-z])|\d+")
_UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "sek": 1.0, "ms": 1e-3, "us": 1e-6},
    "angle": {"°": DEG, "deg": DEG, "grad": DEG, "rad": 1.0},
    "length": {"mm": 1e-3, "m": 1.0},
}
"""Units of each quantity, in SI; `grad` is German for degree."""

_EVERY_UNIT = {unit for units in _UNITS.values() for unit in units}


@dataclass(frozen=True)
class Channel:
    """One channel as recorded.

    Attributes
    ----------
    unit
        As the header names it, None where it does not.
    values : (n,)
        In that unit.
    line
        The header's line that names the channel.
    time
        Whether it holds the time of all others.
    """

    name: str
    unit: str | None
    values: Array
    line: int
    time: bool = False


def meaning(name: str) -> tuple[Kind, str] | None:
    """Return the meaning of a channel's name: measured or commanded or neither, and one of X to C or A1 to A6.

    None is returned unless every word of the name is understood: a speed is not a position.

    Examples
    --------
    >>> meaning("AxisPos_Act3"), meaning("$POS_ACT.X"), meaning("AxisVel_Act3")
    (('measured', 'A3'), ('measured', 'X'), None)
    """
    words = [word.lower() for word in _WORD.findall(name)]
    kind: Kind = "bare"
    if _COMMANDED.intersection(words):
        kind = "commanded"
    elif _MEASURED.intersection(words):
        kind = "measured"
    words_left = [word for word in words if word not in _MEASURED | _COMMANDED | _WITHOUT_MEANING]
    coordinate = "".join(words_left).upper()
    if len(words_left) == 1 and coordinate.isdecimal() and _OF_AN_AXIS.intersection(words):
        coordinate = f"A{coordinate}"
    return (kind, coordinate) if coordinate in (*JOINTS, *POSITION, *ORIENTATION) else None


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, or none at all."""
    return _plain(text) in _EVERY_UNIT | {""}


def _plain(unit: str) -> str:
    return unit.strip().strip("[]()").strip().lower().replace("µ", "u").replace("º", "°")


def factor(channel: Channel, quantity: str, usual: str, source: Path) -> float:
    """Return the size of a channel's unit in SI; a channel without unit is assumed in the usual one.

    Raises
    ------
    RecordingError
        If it is not a unit of the quantity.
    """
    unit = _plain(channel.unit or "") or usual
    if unit not in _UNITS[quantity]:
        known = ", ".join(f"[{known}]" for known in _UNITS[quantity])
        raise RecordingError(
            f"channel '{channel.name}' is in [{channel.unit}]; expected {known} for this {quantity}: "
            "correct the unit, or trace another channel",
            file=source,
            line=channel.line,
        )
    return _UNITS[quantity][unit]


def choose(channels: Sequence[Channel], wanted: Sequence[str], source: Path) -> list[Channel] | None:
    """Return the measured channels of some coordinates, in their order, or None where one is missing.

    Channels whose names say neither measured nor commanded are used if there are no commanded ones.

    Raises
    ------
    RecordingError
        If two channels have the same meaning.
    """
    kinds: list[Kind] = ["measured"]
    if not any(known == ("commanded", w) for w in wanted for known in map(_of, channels)):
        kinds.append("bare")
    for kind in kinds:
        found: dict[str, Channel] = {}
        for channel in channels:
            known = _of(channel)
            if known is None or known[0] != kind or known[1] not in wanted:
                continue
            if (first := found.setdefault(known[1], channel)) is not channel:
                raise RecordingError(
                    f"channels '{first.name}' (line {first.line}) and '{channel.name}' both mean {known[1]}; "
                    "keep one of them",
                    file=source,
                    line=channel.line,
                )
        if len(found) == len(wanted):
            return [found[name] for name in wanted]
    return None


def _of(channel: Channel) -> tuple[Kind, str] | None:
    return None if channel.time else meaning(channel.name)

"""Readings of an IMU as lines of text, columns separated by commas, over TCP or a serial line.

The user, or a first line, with or without ``#`` before it, names the columns as in the header of `imu0/data.csv`, for
example ``t [ms],w_x [deg/s],w_y,w_z,a_x [g],a_y,a_z``. A unit applies to its column and those after it, until another
unit is named. Columns with other names are skipped.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from operator import xor

from kreisel.errors import ProtocolError
from kreisel.protocols.samples import ImuSample, checked_stamp, finite
from kreisel.units import DEG, MG, STANDARD_GRAVITY

MAX_BYTES = 4096
"""Largest number of bytes of a line."""

COLUMNS = "t [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"

NAME = "CSV line"
"""With which errors about a line begin."""

_TIME = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}  # ns
_RATE = {"rad s^-1": 1.0, "rad/s": 1.0, "deg s^-1": DEG, "deg/s": DEG, "dps": DEG}  # rad/s
_RATE["mdps"] = 1e-3 * _RATE["dps"]
_FORCE = {"m s^-2": 1.0, "m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": MG}  # m/s^2
_UNITS = {"w": _RATE, "a": _FORCE}
_NAMES = re.compile(r"[A-Za-z]\w*\s*[\[,]")
_OF_AN_IMU = re.compile(r"\b[wa]_[xyz]\b", re.IGNORECASE)
_CELL = re.compile(r"\s*([A-Za-z]\w*)\s*(?:\[([^\]]*)\])?\s*")


@dataclass(frozen=True)
class Columns:
    """Positions of stamp, rates and accelerations in a line, and the factors to SI units."""

    count: int
    stamp: int
    stamp_factor: int
    places: tuple[int, ...]
    factors: tuple[float, ...]

    @classmethod
    def parse(cls, text: str) -> Columns:
        """Return the columns that a header names.

        Raises
        ------
        ProtocolError
            If one of the seven columns is missing, or has an unknown unit.
        """
        cells = text.lstrip("#").split(",")
        places: dict[str, tuple[int, float]] = {}
        unit = ""
        for i, cell in enumerate(cells):
            match = _CELL.fullmatch(cell)
            if match is None:
                raise ProtocolError(NAME, f"column {i + 1}, '{cell.strip()[:40]}', is not 'name [unit]'")
            name = match.group(1).lower()
            unit = unit if match.group(2) is None else match.group(2).strip()
            if name in ("t", "timestamp", "time", "stamp"):
                places["t"] = (i, float(_factor(_TIME, unit, name)))
            elif re.fullmatch("[wa]_[xyz]", name):
                places[name] = (i, _factor(_UNITS[name[0]], unit, name))
        wanted = [f"{kind}_{axis}" for kind in "wa" for axis in "xyz"]
        missing = [name for name in ("t", *wanted) if name not in places]
        if missing:
            raise ProtocolError(NAME, f"no column {', '.join(missing)} in '{text[:80]}'; name them as in '{COLUMNS}'")
        return cls(
            len(cells), places["t"][0], int(places["t"][1]),
            tuple(places[name][0] for name in wanted), tuple(places[name][1] for name in wanted),
        )  # fmt: skip


def _factor(units: dict[str, float] | dict[str, int], unit: str, name: str) -> float:
    if unit not in units:
        raise ProtocolError(NAME, f"column {name} is in '{unit}'; known units are {', '.join(units)}")
    return units[unit]


class Decoder:
    """Decodes the lines of a byte stream; an incomplete first line is skipped.

    Parameters
    ----------
    columns
        The user's; None to take them from the line that names them.
    """

    def __init__(self, columns: Columns | None = None) -> None:
        self.columns, self._stated = columns, columns is not None
        self._names_error: ProtocolError | None = None
        self._buffer = bytearray()
        self._begun = False

    def receive(self, data: bytes) -> list[ImuSample | ProtocolError]:
        """Return the readings of the lines that are now complete, and an error for each invalid line."""
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        out: list[ImuSample | ProtocolError] = []
        if len(rest) > MAX_BYTES:
            out.append(ProtocolError(NAME, f"line of more than {MAX_BYTES} bytes: is this a stream of text?"))
            rest = bytearray()
            self._begun = False
        self._buffer = bytearray(rest)
        for line in lines:
            begun, self._begun = self._begun, True
            try:
                reading = self._line(line)
            except ProtocolError as error:
                if begun:
                    out.append(error)
                continue
            if reading is not None:
                out.append(reading)
        return out

    def _line(self, line: bytearray) -> ImuSample | None:
        text = line.decode("ascii", "replace").strip()
        marked = text.startswith("#")
        names = bool(marked or _NAMES.match(text))  # a header, with or without its sign
        if names and self.columns is None:
            self._take_names(text)
        elif names and not self._stated and _names_all(text):  # another one: it holds from here on
            self.columns = None
            self._take_names(text)
        elif text and not marked:
            return self._numbers(text)
        return None

    def _take_names(self, text: str) -> None:
        """Take the columns of a header; a comment that names none of them is no header."""
        try:
            self.columns = Columns.parse(text)
        except ProtocolError as error:
            if not text.startswith("#") or _OF_AN_IMU.search(text):
                self._names_error = error
            raise

    def _numbers(self, text: str) -> ImuSample:
        text = without_checksum(text)
        if self.columns is None:
            if self._names_error is not None:
                raise self._names_error
            raise ProtocolError(
                NAME, f"'{text[:60]}' came before a line with the columns' names; name them, for example "
                f"'?columns={COLUMNS}'"
            )  # fmt: skip
        return decode(text, self.columns)


def _names_all(text: str) -> bool:
    """Return whether a line names all six readings, as a header does, and no comment."""
    return len({name.lower() for name in _OF_AN_IMU.findall(text)}) == len(_UNITS) * 3


def without_checksum(text: str) -> str:
    """Return a line without the checksum at its end, if it has one: ``*`` and two hexadecimal digits, as in NMEA 0183.

    It is the exclusive or of all characters before the asterisk, but for a ``$`` at the beginning.

    Raises
    ------
    ProtocolError
        If it is not that of the line.
    """
    content, star, stated = text.rpartition("*")
    if not star:
        return text
    content = content.removeprefix("$")
    if not re.fullmatch(r"[0-9A-Fa-f]{2}", stated) or int(stated, 16) != functools.reduce(xor, content.encode(), 0):
        raise ProtocolError(NAME, f"the checksum '*{stated[:8]}' is not that of the line '{content[:60]}'")
    return content


def decode(text: str, columns: Columns) -> ImuSample:
    """Return the reading of a line.

    Raises
    ------
    ProtocolError
        If the number of columns is wrong, or a value is not a number.
    """
    cells = text.split(",")
    if len(cells) != columns.count:
        raise ProtocolError(NAME, f"{len(cells)} columns, expected {columns.count}: '{text[:60]}'")
    try:
        stamp = cells[columns.stamp].strip()
        if columns.stamp_factor == 1 or re.fullmatch(r"[-+]?\d{1,20}", stamp):
            stamp_ns = int(stamp) * columns.stamp_factor
        else:
            stamp_ns = round(float(stamp) * columns.stamp_factor)
        values = tuple(float(cells[i]) * factor for i, factor in zip(columns.places, columns.factors, strict=True))
    except (ValueError, OverflowError) as error:
        raise ProtocolError(NAME, f"not a line of numbers: '{text[:60]}'") from error
    values = finite(values, NAME, "a reading")
    return ImuSample(
        checked_stamp(stamp_ns, NAME), (values[0], values[1], values[2]), (values[3], values[4], values[5])
    )


def encode(reading: ImuSample) -> bytes:
    """Return the line of a reading in `COLUMNS`."""
    values = ",".join(repr(float(value)) for value in (*reading.rate, *reading.acceleration))
    return f"{reading.stamp_ns},{values}\n".encode()

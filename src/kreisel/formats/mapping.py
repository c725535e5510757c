"""Which columns of which tables hold what: `[columns]` in recording.toml, or `--map` on the command line.

A value names columns, divided by commas, each with a sign and a unit if it needs one; a unit after the last one is
that of all:

    imu.time = "t [ms]"                      also "tick [1000 Hz]", "sec [s] + nsec [ns]", "utc [date]", "400 Hz"
    imu.rate = "gx, gy, -gz [deg/s]"
    imu.acceleration = "#5-7 [g]"            columns by number
    reference.position = "X, Y, Z [mm]"
    reference.orientation = "kuka abc: A, B, C [deg]"
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from kreisel.errors import SettingsError, unknown_name
from kreisel.formats.rotation_forms import columns_of, quantity_of
from kreisel.recording.header import UNITS, plain_unit
from kreisel.recording.recording_settings import ColumnsTable

_UNIT = re.compile(r"^(.*?)\s*\[\s*([^\[\]]*?)\s*\]\s*$")
_RANGE = re.compile(r"^#(\d+)\s*-\s*#?(\d+)$")
_MAX = 1000  # columns of a range; chosen as in `csv_table`: a matrix has 16
_ONE_IMU = re.compile(r"^(imu\d+)\.(\w+)$")
_HERTZ = re.compile(r"^([0-9.eE+]+)\s*Hz$")


@dataclass(frozen=True)
class Term:
    """A column with its sign and unit; the unit is None where it is that of the header, or SI."""

    name: str
    sign: float = 1.0
    unit: str | None = None


@dataclass(frozen=True)
class TimeRule:
    """How stamps are made: columns that are added, a counter with its rate, or the number of the row with a rate.

    Attributes
    ----------
    terms
        Columns, none where rows are counted.
    hertz
        Rate of a counter or of the rows; None where the columns are times.
    """

    terms: tuple[Term, ...]
    hertz: float | None = None


def parse_terms(text: str, quantity: str) -> tuple[Term, ...]:
    """Return the columns that a text names.

    Raises
    ------
    SettingsError
        If it cannot be read, or a unit is not one of the quantity.
    """
    terms: list[Term] = []
    for part in _parts(text):
        match = _UNIT.match(part)
        name, unit = (match.group(1), plain_unit(match.group(2))) if match else (part, None)
        if unit is not None and unit not in UNITS[quantity] and (unit, quantity) != ("date", "time"):
            raise SettingsError(f"'{text}': [{unit}] is not a unit of {quantity}; known: {', '.join(UNITS[quantity])}")
        sign = -1.0 if name.startswith("-") else 1.0
        name = name[name.startswith(("+", "-")) :].strip()
        if not name or name.startswith(("+", "-")):
            raise SettingsError(f"'{text}': a column has no name, or two signs; name columns, divided by commas")
        between = _RANGE.match(name)
        if between and not 0 <= int(between[2]) - int(between[1]) < _MAX:
            raise SettingsError(f"'{text}': {name} is no range of up to {_MAX} columns, from the first to the last")
        names = [f"#{k}" for k in range(int(between[1]), int(between[2]) + 1)] if between else [name]
        terms += [Term(one, sign, unit) for one in names]
    stated = {term.unit for term in terms if term.unit is not None}
    if len(stated) == 1:
        terms = [Term(term.name, term.sign, term.unit or next(iter(stated))) for term in terms]
    return tuple(terms)


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def parse_time(text: str) -> TimeRule:
    """Return how stamps are made.

    Raises
    ------
    SettingsError
        If the text cannot be read.
    """
    if counted := _HERTZ.match(text.strip()):
        return TimeRule((), _rate(counted[1], text))
    match = _UNIT.match(text)
    if match and (counter := _HERTZ.match(match[2])):
        return TimeRule((Term(match[1].strip()),), _rate(counter[1], text))
    terms = [parse_terms(part.strip(), "time") for part in text.split(" + ")]
    if any(len(part) != 1 or part[0].sign < 0.0 for part in terms):
        raise SettingsError(f"'{text}': one column of time, or some divided by ' + ', without signs")
    return TimeRule(tuple(part[0] for part in terms))


def _rate(number: str, text: str) -> float:
    try:
        rate = float(number)
    except ValueError:
        rate = 0.0
    if not 1e-3 < rate < 1e12:
        raise SettingsError(f"'{text}': {number} Hz is not a possible rate")
    return rate


def parse_orientation(text: str) -> tuple[str, tuple[Term, ...]]:
    """Return the form of rotations and its columns, of 'FORM: columns'.

    Raises
    ------
    SettingsError
        If the form is unknown, or has another number of columns.
    """
    form, colon, names = text.partition(":")
    form = " ".join(form.split())
    expected = columns_of(form)
    if not colon:
        raise SettingsError(f"'{text}': write the form, a colon, and the columns, as 'quaternion wxyz: qw, qx, qy, qz'")
    terms = parse_terms(names, quantity_of(form))
    if len(terms) not in expected:
        wanted = " or ".join(map(str, expected))
        raise SettingsError(f"'{text}': {len(terms)} columns, but '{form}' has {wanted}")
    return form, terms


def merged(table: ColumnsTable | None, pairs: Iterable[str] | Mapping[str, str]) -> ColumnsTable:
    """Return the table with further entries, 'imu.time=t [ms]' each; they replace those of the same name.

    Raises
    ------
    SettingsError
        For an entry that is not known.
    """
    content = {} if table is None else table.model_dump(exclude_none=True)
    known = {f"{name}.{key}": (name, key) for name in ("imu", "reference", "joints")
             for key in type(getattr(ColumnsTable(), name)).model_fields}  # fmt: skip
    pairs = [pairs] if isinstance(pairs, str) else pairs
    entries = pairs.items() if isinstance(pairs, Mapping) else (pair.partition("=")[::2] for pair in pairs)
    for name, value in entries:
        name = name.strip()
        one_imu = _ONE_IMU.match(name)
        plain = f"imu.{one_imu[2]}" if one_imu else name
        if plain not in known:
            raise SettingsError(unknown_name("column", name, known) + "; write --map 'imu.time=t [ms]'")
        if not str(value).strip():
            raise SettingsError(f"--map {name}: no columns are named")
        group, key = known[plain]
        place = content.setdefault("imus", {}).setdefault(one_imu[1], {}) if one_imu else content.setdefault(group, {})
        place[key] = str(value).strip()
    return ColumnsTable.model_validate(content)

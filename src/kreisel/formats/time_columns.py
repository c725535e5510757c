"""The time of a stream in a table: which columns may hold it, and in which units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel.formats.column_names import known_unit, read_name
from kreisel.formats.sheet import Sheet
from kreisel.recording.header import UNITS

SLOWEST_IMU, SLOWEST_POSES, FASTEST = 5.0, 0.05, 20e3
"""Hz; rates at which samples and poses come."""

_SHORTEST, _LONGEST = 2.0, 1e6  # s
_ASCENDING = 0.98
"""Share of the steps of a time that do not go back. Chosen: packets may be exchanged, and a clock set, now and then;
values that are no time go back in half of the steps."""

_ALIKE = 0.6
"""Points by which one time must be better than another to be preferred."""

_OF_THE_PC = re.compile(r"host|arriv|recei|recv|(^|_)(pc|sys|system|log|logged|wall|ros)(_|$)")
_COUNTERS = {"sampletimefine": 10_000}
"""Hz; rates of counters with names of their own: that of Xsens (MT Low-Level Communication Protocol)."""

_DATE = re.compile(r"\d{4}[-/]\d\d?[-/]\d\d?|\d\d?\.\d\d?\.\d{4}")
_TIME_OF_DAY = re.compile(r"\d?\d:\d\d(:\d\d([.,]\d+)?)?")


@dataclass(frozen=True)
class TimeColumn:
    """One way to read a time: the text of the mapping, its points, and Hz and seconds that follow from it."""

    text: str
    points: float
    rate: float
    seconds: float
    places: tuple[int, ...]


def times_of(sheet: Sheet, places: tuple[int, ...], owner: tuple[str, ...], slowest: float) -> list[TimeColumn]:
    """Return the ways to read the time of some columns, the likeliest first; only those about as likely as that.

    Parameters
    ----------
    owner
        Of the columns; see `Name`.
    slowest
        Hz; least rate of such a stream.
    """
    found = [one for one in _candidates(sheet, places, owner, slowest) if one.points > 0.0]
    found.sort(key=lambda one: -one.points)
    return [one for one in found if one.points > found[0].points - _ALIKE]


def _candidates(sheet: Sheet, places: tuple[int, ...], owner: tuple[str, ...], slowest: float) -> Iterator[TimeColumn]:
    rows = known_cells(sheet.columns[places[0]])
    yield from _dates(sheet, rows, slowest)
    for k, column in enumerate(sheet.columns):
        name = read_name(sheet.names[k])
        apart = bool(sheet.lengths) and sheet.lengths[k] != sheet.lengths[places[0]]
        if apart or k in places or column.dtype.kind in "OUS" or name.quantity not in ("time", ""):
            continue
        known = known_cells(column)
        here = rows & known
        steps = np.diff(column[here].astype(np.float64))
        if np.sum(steps > 0.0) < 10 or np.mean(steps >= 0.0) < _ASCENDING:
            continue
        points = _points(sheet, k, rows, owner) + (2.0 if name.quantity == "time" else -0.5)
        points += 4.0 if not rows.all() and bool((known == rows).all()) else 0.0
        points += 4.0 if _held_alike(column, sheet.columns[places[0]]) else 0.0
        rest = _rest_of_second(sheet, k, steps)
        if rest is not None:
            whole = column[here].astype(np.float64) + sheet.columns[rest[0]][here] / rest[1]
            text = f"{called(sheet, k)} [s] + {called(sheet, rest[0])} [{rest[2]}]"
            yield from _read(text, points + 1.0, np.diff(whole), 1e9, slowest, (k, rest[0]))
            continue
        if name.quantity == "" and (steps[steps > 0.0] == 1.0).all() and np.mean(steps == 1.0) > 0.9:
            continue  # a count of rows
        counter = _COUNTERS.get(re.sub(r"[^a-z0-9]+", "", sheet.names[k].lower()))
        if counter is not None:
            yield from _read(f"{called(sheet, k)} [{counter} Hz]", points + 2.5, steps, 1e9 / counter, slowest, (k,))
            continue
        stated = known_unit(sheet.units[k] or name.unit, "time")
        for unit in UNITS["time"] if stated is None else (stated,):
            text = called(sheet, k) if known_unit(sheet.units[k], "time") == sheet.units[k] == stated and stated else (
                f"{called(sheet, k)} [{unit}]"
            )  # fmt: skip
            yield from _read(text, points, steps, UNITS["time"][unit], slowest, (k,))


def _read(
    text: str, points: float, steps: NDArray[Any], size: float, slowest: float, places: tuple[int, ...]
) -> Iterator[TimeColumn]:
    """Yield a time if its rate and its length, in a unit (ns), are possible."""
    positive = steps[steps > 0.0]
    rate, seconds = 1e9 / (float(np.median(positive)) * size), float(steps.sum()) * size * 1e-9
    if slowest <= rate <= FASTEST and _SHORTEST <= seconds <= _LONGEST:
        yield TimeColumn(text, points, rate, seconds, places)


def _points(sheet: Sheet, k: int, rows: NDArray[np.bool_], owner: tuple[str, ...]) -> float:
    """Return how well a column fits others as their time: it is known where they are, and of the same owner."""
    known = known_cells(sheet.columns[k])
    points = float(4.0 * np.mean(known[rows]) - 2.0 * np.mean(known & ~rows))
    plain = re.sub(r"[^a-z0-9]+", "_", sheet.names[k].lower())
    words = set(plain.split("_"))
    points += 2.0 if owner and set(owner) & words else 0.0
    points += 0.25 if k == 0 else 0.0
    return points - (1.0 if _OF_THE_PC.search(plain) else 0.0)


def _held_alike(time: NDArray[Any], column: NDArray[Any]) -> bool:
    """Return whether a time repeats just where another column does: both are held until the next pose."""
    same, held = time[1:] == time[:-1], column[1:] == column[:-1]
    return bool(np.mean(same) > 0.1 and np.mean(held[same]) > 0.98)


def _rest_of_second(sheet: Sheet, k: int, steps: NDArray[Any]) -> tuple[int, float, str] | None:
    """Return the column beside whole seconds that holds the rest of each, its numbers in a second, and its unit."""
    column = sheet.columns[k]
    if not (steps[steps > 0.0] == 1.0).all() or np.mean(steps == 0.0) < 0.5 or k + 1 >= len(sheet.columns):
        return None
    rest = sheet.columns[k + 1]
    if rest.dtype.kind not in "iuf" or column.dtype.kind in "OUS":
        return None
    known = rest[np.isfinite(rest)]
    named = (read_name(sheet.names[k + 1]).unit, known_unit(sheet.names[k + 1], "time"))
    for unit, size in (("ns", 1e9), ("us", 1e6), ("ms", 1e3)):
        whole = bool((np.mod(known, 1.0) == 0.0).all()) or unit in named
        if known.size and whole and known.min() >= 0 and 0.5 * size < known.max() < size:
            return k + 1, size, unit
    return None


def _dates(sheet: Sheet, rows: NDArray[np.bool_], slowest: float) -> Iterator[TimeColumn]:
    """Yield dates with times, dates and times in two columns, and times of the day."""
    text = {k: str(column[np.flatnonzero(rows)[0]]).strip() for k, column in enumerate(sheet.columns)
            if column.dtype.kind in "OUS" and rows.any()}  # fmt: skip
    days = [k for k, cell in text.items() if _DATE.fullmatch(cell)]
    hours = [k for k, cell in text.items() if _TIME_OF_DAY.fullmatch(cell)]
    whole = [k for k, cell in text.items() if (m := _DATE.match(cell)) and m.end() < len(cell)]
    both: list[tuple[int, ...]] = [(day, hour) for hour in hours for day in days[:1]]
    for places in [*((k,) for k in whole), *(both or [(k,) for k in hours])]:
        names = " + ".join(f"{called(sheet, k)} [date]" for k in places)
        points = _points(sheet, places[-1], rows, ()) + 2.0
        first, last = (_second_of_day(str(sheet.columns[places[-1]][k])) for k in np.flatnonzero(rows)[[0, -1]])
        seconds = (last - first) % 86_400.0 or 86_400.0
        rate = (rows.sum() - 1) / seconds
        if slowest <= rate <= FASTEST and seconds >= _SHORTEST:
            yield TimeColumn(names, points, rate, seconds, places)


def _second_of_day(cell: str) -> float:
    match = re.search(r"(\d?\d):(\d\d)(?::(\d\d(?:[.,]\d+)?))?", cell)
    if match is None:
        return 0.0
    return 3600.0 * float(match[1]) + 60.0 * float(match[2]) + float((match[3] or "0").replace(",", "."))


def rates_of(sheet: Sheet, owner: tuple[str, ...]) -> list[str]:
    """Return the rates that single numbers state, as times of counted rows; of the owner alone if it has some."""
    found: list[tuple[str, tuple[str, ...]]] = []
    for name, value in [*sheet.scalars, *_constants(sheet)]:
        text = re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
        if re.search(r"(^|_)(fs|f_s|hz|freq|frequency|fps|sr)(_|$)|rate|frequen|freq$", text):
            hertz = value
        elif re.search(r"(^|_)(dt|ts)(_|$)|period|interval|sample_?time|sampling_?time", text) and value > 0.0:
            hertz = 1.0 / value
        else:
            continue
        if SLOWEST_POSES <= hertz <= FASTEST:
            found.append((f"{hertz:.9g} Hz", tuple(text.split("_"))))
    own = [one for one in found if set(owner) & set(one[1])]
    return list(dict.fromkeys(text for text, _ in own or found))


def _constants(sheet: Sheet) -> Iterator[tuple[str, float]]:
    """Yield columns that hold one number in all rows."""
    for name, column in zip(sheet.names, sheet.columns, strict=True):
        if column.dtype.kind in "fiu" and np.isfinite(column[0]) and (column == column[0]).all():
            yield name, float(column[0])


def counter_of(sheet: Sheet, places: tuple[int, ...]) -> int | None:
    """Return the column that counts the rows of a stream, None where there is none."""
    rows = known_cells(sheet.columns[places[0]])
    for k, column in enumerate(sheet.columns):
        if column.dtype.kind in "fiu" and read_name(sheet.names[k]).quantity in ("counter", ""):
            values = column[rows & known_cells(column)].astype(np.float64)
            steps = np.diff(values)
            if values.size == rows.sum() and steps.size and np.mean(steps == 1.0) > 0.9 and (steps >= 1.0).all():
                return k
    return None


def known_cells(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which cells of a column are not empty, (n,)."""
    if column.dtype.kind == "f":
        return np.isfinite(column)
    return column != "" if column.dtype.kind in "OUS" else np.ones(column.size, dtype=bool)


def called(sheet: Sheet, k: int) -> str:
    """Return the name of a column, or its number where the name is not unique or would be read otherwise."""
    name = sheet.names[k]
    lower = [own.lower() for own in sheet.names]
    plain = (sheet.names.count(name) == 1 or lower.count(name.lower()) == 1) and not re.search(
        r"[,\[\]:+\"\\]|^[-+#]|^$", name
    )
    return name if plain else f"#{k + 1}"

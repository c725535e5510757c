"""What stands above the table in exports of motion capture: facts about the take, and names in several lines."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from kreisel.formats.csv_table import is_number
from kreisel.recording.header import UNITS

_DELIMITERS = ("\t", ",", ";")

_SEARCHED, _ALIKE = 40, 20
"""Lines among which the first row of numbers is looked for, and rows that look like it. Chosen: exports have up to
seven lines above them, and one for each body."""

_ABOVE = 6
"""Lines of names at most. Chosen: type, name, number, what of it, and axis."""

_USUAL = 2
"""Lines of a usual header: names and units."""

COMMENTS = ("#", "%", "//")
"""How lines begin that are no rows."""

_KNOWN = {unit for units in UNITS.values() for unit in units} - {"", "1", "-"}


@dataclass(frozen=True)
class Preamble:
    """Lines of a table with one line of names, and one of units, above it, and single numbers from above these."""

    lines: Sequence[str]
    scalars: tuple[tuple[str, float], ...] = field(default=())


def without_preamble(lines: Sequence[str]) -> Preamble:
    """Return the lines of a text with a usual header; as they are where they have one, or where no table is found.

    Lines that are taken out are empty then, so that others keep their numbers.
    """
    for delimiter in _DELIMITERS:
        first = _first_row(lines, delimiter)
        if first is None:
            continue
        count = len(_cells(lines[first], delimiter))
        begin = first
        while begin > max(0, first - _ABOVE) and len(_cells(lines[begin - 1], delimiter)) == count:
            begin -= 1
        named = [_cells(line, delimiter) for line in lines[begin:first]]
        above = [line for line in lines[:begin] if line.strip() and not line.lstrip().startswith(COMMENTS)]
        if not named or (not above and len(named) <= _USUAL):
            return Preamble(lines)
        units = named.pop() if len(named) > 1 and _are_units(named[-1]) else None
        out = [_row(_names(named), delimiter), *([] if units is None else [_row(units, delimiter)])]
        blank = [""] * (first - len(out))
        scalars = [pair for line in above for pair in _pairs(_cells(line, delimiter))]
        return Preamble([*blank, *out, *lines[first:]], tuple(scalars))
    return Preamble(lines)


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _first_row(lines: Sequence[str], delimiter: str) -> int | None:
    """Return the first line of numbers that many like it follow; None where there is none."""
    for k in range(min(_SEARCHED, len(lines) - _ALIKE)):
        found = [_cells(line, delimiter) for line in lines[k : k + _ALIKE]]
        count = len(found[0])
        if count < 4 or {len(cells) for cells in found} != {count}:
            continue
        if all(2 * sum(map(is_number, cells)) > count for cells in found):
            return k
    return None


def _are_units(cells: Sequence[str]) -> bool:
    return any(cells) and all(not cell or cell in _KNOWN for cell in cells)


def _names(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the last of several lines of names; with what stands above each where some are alike."""
    last = [cell for cell in rows[-1] if cell]
    if len(set(last)) == len(last):
        return list(rows[-1])
    return [" ".join(dict.fromkeys(cell for cell in column if cell)) for column in zip(*rows, strict=True)]


def _row(cells: Sequence[str], delimiter: str) -> str:
    return delimiter.join(f'"{cell}"' if delimiter in cell else cell for cell in cells)


def _pairs(cells: Sequence[str]) -> list[tuple[str, float]]:
    """Return names and the numbers after them; a number alone on a line is the rate, which Vicon's exports state so."""
    if len(cells) == 1 and is_number(cells[0]):
        return [("frame rate", float(cells[0]))]
    return [(a, float(b)) for a, b in pairwise(cells) if a and not is_number(a) and is_number(b)]

"""A table of the report, and numbers as text in its cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

NOTHING = "–"

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Row:
    """Cells of a row, the first its title; `weak` where the numbers are not observable or not good.

    `bar` is a share from 0 to 1 drawn beneath the last cell.
    """

    cells: tuple[str, ...]
    weak: bool = False
    bar: float | None = None


@dataclass(frozen=True)
class Table:
    """A table: its title, its columns, its rows.

    The first `text` columns are not numbers; `broad` tables turn their rows into blocks on a narrow screen, and `prose`
    tables, with sentences in their cells, into paragraphs.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    text: int = 1
    broad: bool = False
    prose: bool = False


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits."""
    if not math.isfinite(value):
        return NOTHING
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{with_minus(mantissa)}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    places = 0 if value == 0.0 else max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return with_minus(f"{value:.{places}f}")


def pair(value: float | None, deviation: float | None) -> str:
    """Return a value and its standard deviation, both to two digits of the latter."""
    if value is None or not math.isfinite(value):
        return NOTHING
    if deviation is None or not deviation > 0.0 or not math.isfinite(deviation):
        return number(value, 4)
    places = max(0, min(12, 1 - math.floor(math.log10(deviation))))
    return f"{with_minus(f'{value:.{places}f}')} ± {deviation:.{places}f}"


def user_fixed(value: float | None) -> str:
    """Return a value that was not estimated."""
    return NOTHING if value is None or not math.isfinite(value) else f"user-fixed at {number(value, 4)}"


def with_minus(text: str) -> str:
    """Return the text of a number with a minus sign instead of a hyphen, and none before zero."""
    return "−" + text[1:] if text.startswith("-") and text.strip("-0.") else text.removeprefix("-")

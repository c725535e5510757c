"""The units of a batch as a workbook of Excel."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from kreisel.batch.capability import capabilities, capability_table
from kreisel.batch.lot import Unit, table
from kreisel.batch.outcomes import GOOD
from kreisel.calibration.limits import Limits
from kreisel.errors import SettingsError

_COLOURS = {True: "#d9f2e0", False: "#f8d4d0", None: "#fdecc8"}
"""Background by whether a unit is good; None: no decision."""


def check_workbook() -> None:
    """Check that workbooks can be written.

    Raises
    ------
    SettingsError
        Without the extra `xlsx`.
    """
    try:
        import xlsxwriter  # noqa: F401
    except ImportError as error:
        raise SettingsError("--xlsx needs an extra (xlsxwriter): pip install 'kreisel[xlsx]'") from error


def write_workbook(units: Sequence[Unit], limits: Limits | None, path: Path) -> None:
    """Write sheets with units, capability and limits; numbers are numbers.

    Raises
    ------
    SettingsError
        Without the extra `xlsx`.
    """
    check_workbook()
    from xlsxwriter import Workbook

    with Workbook(path, {"strings_to_formulas": False, "strings_to_urls": False}) as book:
        _units(book, units)
        found = capability_table(capabilities(units, limits))
        _sheet(book, "capability", [found.columns, *(row.cells for row in found.rows)])
        rows: list[Sequence[str]] = [("quantity", "first", "second", "third")]
        rows += [(name, *map(repr, values)) for name, values in ({} if limits is None else limits.values).items()]
        _sheet(book, "limits", rows)


def _units(book: Any, units: Sequence[Unit]) -> None:
    sheet = _sheet(book, "units", list(csv.reader(StringIO(table(units)))))
    formats = {good: book.add_format({"bg_color": colour}) for good, colour in _COLOURS.items()}
    for i, unit in enumerate(units):
        good = unit.outcome in GOOD or (None if unit.outcome == "no decision" else False)
        sheet.write_string(i + 1, 5, unit.outcome, formats[good])


def _sheet(book: Any, name: str, rows: Sequence[Sequence[str]]) -> Any:
    sheet, head = book.add_worksheet(name), book.add_format({"bold": True})
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            value = _number(cell) if i else None
            if value is None:
                sheet.write_string(i, j, cell, *([] if i else [head]))
            else:
                sheet.write_number(i, j, value)
    sheet.freeze_panes(1, 1)
    sheet.autofit()
    return sheet


def _number(cell: str) -> float | None:
    """Return the number in a cell, None where it holds text; serial numbers with leading zeros are text."""
    if cell[:1] == "0" and cell[1:2].isdigit():
        return None
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) < 1e300 else None

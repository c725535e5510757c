"""Traces as text: columns named in the first line, the time first, as KUKA's and DIAdem's own tools export them."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.csv_table import is_number
from kreisel.formats.kuka_channels import Channel, is_unit
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning

_MAX_LINE = 1 << 16  # characters; chosen as in `csv_table`: a row of tens of channels has some hundred
_NAME = re.compile(r"\s*(.*?)\s*(?:[\[(]\s*([^\[\]()]*?)\s*[\])])?\s*")


def read_text(path: Path, text: str) -> tuple[list[Channel], list[DataWarning]]:
    """Return the channels of a trace as text, the first of them the time.

    Numbers have points, or commas where tabs or semicolons divide the columns, but never both.

    Raises
    ------
    RecordingError
        If it is not such a table; the message names the line.
    """
    warnings: list[DataWarning] = []
    lines = _whole_lines(text, warnings)
    _check_lengths(path, lines)
    delimiter = next((d for d in "\t;," if any(d in line for line in lines[:20])), None)
    if delimiter is None:
        raise RecordingError(
            "is neither a DIAdem header (#BEGINCHANNELHEADER) nor columns divided by tabs, as of a KUKA trace; give "
            "the .dat that belongs to the .r64 (KR C4), or the text exported from the .trc (KR C2)",
            file=path,
        )
    if delimiter != ",":
        lines = _with_points(path, lines, delimiter)
    lines = [line.rstrip(f" {delimiter}") for line in lines]
    first = next((k for k, line in enumerate(lines) if _is_row(line, delimiter)), len(lines))
    names, units, at = _header(path, lines, first, delimiter)
    values = _numbers(path, lines, first, len(names), delimiter)
    if not units[0]:
        units[0] = "ms"  # what KR C2's tool writes
        warnings.append(DataWarning("trace", f"'{names[0]}' has no unit, so ms is assumed"))
    columns = zip(names, units, values.T, strict=True)
    return [Channel(name, unit, column, at, k == 0) for k, (name, unit, column) in enumerate(columns)], warnings


def _whole_lines(text: str, warnings: list[DataWarning]) -> list[str]:
    lines = text.split("\n")
    if lines[-1].strip():
        warnings.append(DataWarning("trace", f"the last line has no end ('{lines[-1][-40:]}'): it was left out"))
    return lines[:-1]


def _check_lengths(path: Path, lines: list[str]) -> None:
    long = next((k for k, line in enumerate(lines) if len(line) > _MAX_LINE), None)
    if long is not None:
        raise RecordingError(
            f"a line of {len(lines[long])} characters, expected {_MAX_LINE} at most; give the text of a trace",
            file=path,
            line=long + 1,
        )


def _with_points(path: Path, lines: list[str], delimiter: str) -> list[str]:
    """Return the lines with points in numbers; in a file that has both signs their meaning is not clear."""
    pointed = next((k for k, line in enumerate(lines) if _numeric(line, delimiter, ".")), None)
    comma = next((k for k, line in enumerate(lines) if _numeric(line, delimiter, ",")), None)
    if comma is None:
        return lines
    if pointed is not None:
        raise RecordingError(
            f"a number has a comma here, one in line {pointed + 1} a point; expected only one of them, because 1,234 "
            "may be a thousand or one: export without thousands separators",
            file=path,
            line=comma + 1,
        )
    return [line.replace(",", ".") for line in lines]


def _numeric(line: str, delimiter: str, sign: str) -> bool:
    """Return whether a row of numbers has this sign in one of them."""
    return sign in line and any(sign in cell and is_number(cell.replace(",", ".")) for cell in line.split(delimiter))


def _is_row(line: str, delimiter: str) -> bool:
    cells = line.split(delimiter)
    return len(cells) > 1 and all(is_number(cell) for cell in cells)


def _header(path: Path, lines: list[str], first: int, delimiter: str) -> tuple[list[str], list[str | None], int]:
    """Return names and units of the columns, and the line of the names: as many cells as a row has."""
    if first == len(lines):
        raise RecordingError("holds no row of numbers; expected the values of a trace: export it again", file=path)
    width = len(lines[first].split(delimiter))
    heads = [(k, line.split(delimiter)) for k, line in enumerate(lines[:first]) if len(line.split(delimiter)) == width]
    if not heads:
        raise RecordingError(
            f"has no line that names the {width} columns before the first row of numbers; export it with a header",
            file=path,
            line=first + 1,
        )
    (at, head), *others = heads
    parts = [_NAME.fullmatch(cell.strip("\"' ")) for cell in head]
    names = [part[1] if part else cell.strip() for part, cell in zip(parts, head, strict=True)]
    units: list[str | None] = [part[2] if part else None for part in parts]
    for k, cells in others:
        if not all(is_unit(cell) for cell in cells):
            raise RecordingError(
                f"'{lines[k][:60].strip()}' is neither a row of numbers nor of units; repair or delete the line",
                file=path,
                line=k + 1,
            )
        units = [cell.strip() or unit for cell, unit in zip(cells, units, strict=True)]
    return names, units, at + 1


def _numbers(path: Path, lines: list[str], first: int, width: int, delimiter: str) -> Array:
    body = io.StringIO("\n".join(lines[first:]))
    try:
        values = np.loadtxt(body, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        values = np.empty((0, 0))
    if values.shape[1] == width:
        return values
    for number, line in enumerate(lines[first:], start=first + 1):
        cells = line.split(delimiter)
        if not line.strip():
            continue
        if len(cells) != width:
            raise RecordingError(
                f"{len(cells)} values, expected {width} as in the header; repair or delete the row",
                file=path,
                line=number,
            )
        bad = next((cell for cell in cells if not is_number(cell)), None)
        if bad is not None:
            raise RecordingError(
                f"'{bad.strip()[:40]}' is not a number; repair or delete the row", file=path, line=number
            )
    raise RecordingError("cannot be read as a table of numbers; look for unusual characters", file=path)

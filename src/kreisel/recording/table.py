"""CSV tables with a header of names and units, as EuRoC writes them."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import Finding, Stamps
from kreisel.units import DEG, STANDARD_GRAVITY

_UNITS = {
    "time": {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9},
    "rate": {
        "rad s^-1": 1.0, "rad/s": 1.0, "rads^-1": 1.0, "deg s^-1": DEG, "deg/s": DEG, "dps": DEG,
        "mdps": 1e-3 * DEG, "deg/h": DEG / 3600.0,
    },
    "acceleration": {
        "m s^-2": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "ms^-2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY,
    },
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "quaternion": {"": 1.0, "-": 1.0, "1": 1.0},
    "angle": {"rad": 1.0, "deg": DEG},
}  # fmt: skip
_COLUMN = re.compile(r"^\s*#?\s*([^\[\]]*?)\s*(?:\[\s*([^\]]*?)\s*\])?\s*$")


@dataclass(frozen=True)
class Column:
    """A column's place in the table, its name and its unit (None where the header names none)."""

    index: int
    name: str
    unit: str | None


@dataclass(frozen=True)
class Table:
    """A table as read: header, stamps, numbers (n, columns without the stamp), findings."""

    source: Path
    columns: tuple[Column, ...]
    stamps_ns: Stamps
    values: Array
    findings: tuple[Finding, ...]

    def take(self, columns: list[Column], quantity: str) -> Array:
        """Return the named columns (n, k), converted to SI by the unit the header gives.

        Raises
        ------
        RecordingError
            If a unit is none of the quantity's.
        """
        factors = [self._factor(column, quantity) for column in columns]
        picked = self.values[:, [column.index - 1 for column in columns]]
        return np.ascontiguousarray(picked * np.array(factors))

    def _factor(self, column: Column, quantity: str) -> float:
        known = _UNITS[quantity]
        if column.unit is None:
            return 1.0
        if column.unit not in known:
            raise RecordingError(
                f"column {column.index + 1} ('{column.name}') is in [{column.unit}]; for this {quantity} kreisel reads "
                f"{', '.join(f'[{unit}]' for unit in known)}. Convert it, or correct the header",
                file=self.source,
                line=1,
            )
        return known[column.unit]


def read_table(path: Path, what: str) -> Table:
    """Return a CSV table whose first column holds stamps.

    Parameters
    ----------
    what
        What the file holds, for messages.

    Raises
    ------
    RecordingError
        If the file is missing, empty, not text, without header, or has a row that is not numbers.
    """
    if not path.is_file():
        raise RecordingError(f"no such file; expected {what} there", file=path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"not a text file (byte {error.start}); expected {what} as CSV", file=path) from error
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=path) from error
    header, _, body = text.partition("\n")
    if not header.strip():
        raise RecordingError(f"is empty; expected {what} as CSV with a header line", file=path)
    columns = _parse_header(header, path)
    findings: list[Finding] = []
    body = _without_cut_line(body, len(columns), path, findings)
    if not body.strip():
        raise RecordingError(f"has a header but no rows; expected {what}", file=path)
    stamps, values = _parse_body(body, columns, path)
    return Table(path, columns, stamps, values, tuple(findings))


def _parse_header(header: str, path: Path) -> tuple[Column, ...]:
    first = header.split(",")[0].strip()
    if re.fullmatch(r"[-+0-9.eE]+", first):
        raise RecordingError(
            "has no header line; write one that names columns and units, such as "
            "'#timestamp [ns],w_x [rad s^-1],…' for an IMU or '#timestamp [ns],p_x [m],…' for poses",
            file=path,
            line=1,
        )
    columns: list[Column] = []
    for i, part in enumerate(header.strip().rstrip(",").split(",")):
        match = _COLUMN.match(part)
        if match is None:
            raise RecordingError(f"column {i + 1} of the header, '{part.strip()}', is not 'name [unit]'", file=path, line=1)
        unit = match.group(2)
        columns.append(Column(i, match.group(1), None if unit is None else re.sub(r"\s+", " ", unit)))
    # A unit that stands only on the first column of a group holds for the rest of the group.
    for i in range(2, len(columns)):
        before, here = columns[i - 1], columns[i]
        if here.unit is None and before.unit is not None and here.name[:2].lower() == before.name[:2].lower():
            columns[i] = Column(i, here.name, before.unit)
    return tuple(columns)


def _without_cut_line(body: str, width: int, path: Path, findings: list[Finding]) -> str:
    """Drop a last line without an end, where a recorder was stopped in the middle of it."""
    if not body or body.endswith("\n"):
        return body
    head, _, tail = body.rpartition("\n")
    if tail.strip().count(",") + 1 >= width:
        return body + "\n"
    findings.append(Finding(path.name, f"the last line is cut ('{tail[:40]}') and was left out"))
    return head + "\n"


def _parse_body(body: str, columns: tuple[Column, ...], path: Path) -> tuple[Stamps, Array]:
    unit = columns[0].unit or "ns"
    if unit not in _UNITS["time"]:
        raise RecordingError(
            f"stamps are in [{unit}]; kreisel reads {', '.join(f'[{u}]' for u in _UNITS['time'])}", file=path, line=1
        )
    stamp_type = "i8" if unit == "ns" else "f8"
    dtype = np.dtype([("stamp", stamp_type)] + [(f"c{i}", "f8") for i in range(1, len(columns))])
    try:
        rows = np.atleast_1d(np.loadtxt(io.StringIO(body), delimiter=",", dtype=dtype))
    except ValueError as error:
        raise _bad_row(body, columns, stamp_type, path, error) from error
    stamps = rows["stamp"]
    if unit != "ns":
        stamps = np.round(stamps * _UNITS["time"][unit]).astype(np.int64)
    values = np.column_stack([rows[f"c{i}"] for i in range(1, len(columns))]) if len(columns) > 1 else np.empty((stamps.size, 0))
    return stamps, values


def _bad_row(body: str, columns: tuple[Column, ...], stamp_type: str, path: Path, error: ValueError) -> RecordingError:
    """Find the first row that cannot be read and say what is wrong with it."""
    for number, row in enumerate(body.splitlines(), start=2):
        row = row.split("#")[0].strip()
        if not row:
            continue
        cells = row.split(",")
        if len(cells) != len(columns):
            return RecordingError(
                f"{len(cells)} values, expected {len(columns)} as in the header; repair or delete the row",
                file=path,
                line=number,
            )
        for cell, column in zip(cells, columns, strict=True):
            try:
                int(cell) if column.index == 0 and stamp_type == "i8" else float(cell)
            except ValueError:
                expected = "a whole number of nanoseconds" if column.index == 0 else "a number"
                return RecordingError(
                    f"'{cell.strip()}' in column {column.index + 1} ('{column.name}') is not {expected}; "
                    "repair or delete the row",
                    file=path,
                    line=number,
                )
    return RecordingError(f"cannot be read as a table of numbers: {error}", file=path)

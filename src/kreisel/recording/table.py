"""CSV tables with a header of names and units, as EuRoC writes them."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.place import fault
from kreisel.recording.recording import Finding, Stamps
from kreisel.units import DEG, STANDARD_GRAVITY

_UNITS = {
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
_COLUMN = re.compile(r"^\s*#?\s*([^\[\]()]*?)\s*(?:[\[(]\s*([^\[\]()]*?)\s*[\])])?\s*$")
_LARGEST_STAMP = 9.0e18  # ns; a little below what 64 bits hold


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
        with np.errstate(over="ignore"):  # an infinity is found and told by the checks
            return np.ascontiguousarray(picked * np.array(factors))

    def _factor(self, column: Column, quantity: str) -> float:
        known = _UNITS[quantity]
        if column.unit is None:
            return 1.0
        if column.unit not in known:
            raise RecordingError(
                f"column {column.index + 1} ('{column.name}') is in [{column.unit}]; for this {quantity} kreisel "
                f"reads {_listed(quantity)}. Convert it, or correct the header",
                file=self.source,
                line=1,
            )
        return known[column.unit]


def _listed(quantity: str) -> str:
    return ", ".join(f"[{unit}]" for unit in _UNITS[quantity])


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
    header, _, body = _read_text(path, what).partition("\n")
    if not header.strip():
        raise RecordingError(f"is empty; expected {what} as CSV with a header line", file=path)
    if header.rstrip().endswith(","):
        body = re.sub(r",[ \t]*$", "", body, flags=re.MULTILINE)
    columns = _parse_header(header, path)
    findings: list[Finding] = []
    body = _without_cut_line(body, path, findings)
    if not body.strip():
        raise RecordingError(f"has a header but no rows; expected {what}: record again", file=path)
    stamps, values = _parse_body(body, columns, path)
    return Table(path, columns, stamps, values, tuple(findings))


def _read_text(path: Path, what: str) -> str:
    """Return a file's text, or say what stands in its place."""
    try:
        if not path.is_file():
            raise RecordingError(f"{_instead(path)}; expected {what} there", file=path)
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror}; check its permissions, or copy it again", file=path
        ) from error
    if b"\0" in data:
        where = data.index(b"\0")
        guess = "text in UTF-16: save it as UTF-8" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else (
            "binary, or left so by a loss of power: take what is before, or copy it again"
        )  # fmt: skip
        line = data.count(b"\n", 0, where) + 1
        raise RecordingError(
            f"holds a zero byte (byte {where}), which no CSV does; it is {guess}", file=path, line=line
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise RecordingError(
            f"not UTF-8 text (byte {error.start}); expected {what} as CSV: save it in UTF-8", file=path, line=line
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _instead(path: Path) -> str:
    """Return what stands where a file should be."""
    if path.is_dir():
        return "is a folder, not a file"
    if path.is_symlink():
        return "is a link that leads nowhere"
    return "is not an ordinary file" if path.exists() else "no such file"


def _parse_header(header: str, path: Path) -> tuple[Column, ...]:
    first = header.split(",")[0].strip()
    if re.fullmatch(r"[-+0-9.eE]+", first):
        raise RecordingError(
            "has no header line; write one that names columns and units, such as "
            "'#timestamp [ns],w_x [rad s^-1],…' for an IMU or '#timestamp [ns],p_x [m],…' for poses",
            file=path,
            line=1,
        )
    if "," not in header and re.search(r"[;\t]", header):
        raise RecordingError(
            "columns are divided by semicolons or tabs, expected commas (and points in numbers); convert the file",
            file=path,
            line=1,
        )
    columns: list[Column] = []
    for i, part in enumerate(header.strip().rstrip(",").split(",")):
        match = _COLUMN.match(part.strip().strip("\"'"))
        if match is None:
            raise RecordingError(
                f"column {i + 1} of the header, '{part.strip()[:60]}', is not 'name [unit]'; correct the header",
                file=path,
                line=1,
            )
        unit = match.group(2)
        columns.append(Column(i, match.group(1), None if unit is None else re.sub(r"\s+", " ", unit)))
    # A unit that stands only on the first column of a group holds for the rest of the group.
    for i in range(2, len(columns)):
        before, here = columns[i - 1], columns[i]
        if here.unit is None and before.unit is not None and here.name[:2].lower() == before.name[:2].lower():
            columns[i] = Column(i, here.name, before.unit)
    return tuple(columns)


def _without_cut_line(body: str, path: Path, findings: list[Finding]) -> str:
    """Drop a last line without an end: a recorder was stopped in it, perhaps in the middle of a number."""
    if not body or body.endswith("\n"):
        return body
    head, _, tail = body.rpartition("\n")
    name = f"{path.parent.name}/{path.name}"
    findings.append(Finding(name, f"the last line has no end ('{tail[-40:]}'): it may be cut and was left out"))
    return head + "\n" if head else ""


def _parse_body(body: str, columns: tuple[Column, ...], path: Path) -> tuple[Stamps, Array]:
    unit = columns[0].unit or "ns"
    if unit not in _UNITS["time"]:
        raise RecordingError(
            f"stamps are in [{unit}]; kreisel reads {_listed('time')}. Convert them, or correct the header",
            file=path,
            line=1,
        )
    stamp_type = "i8" if unit == "ns" else "f8"
    dtype = np.dtype([("stamp", stamp_type)] + [(f"c{i}", "f8") for i in range(1, len(columns))])
    # a StringIO would keep four bytes a character and be read three times slower
    text = io.TextIOWrapper(io.BytesIO(body.encode()), encoding="utf-8")
    try:
        rows = np.atleast_1d(np.loadtxt(text, delimiter=",", dtype=dtype))
    except ValueError as error:
        raise _bad_row(body, columns, stamp_type, path, error) from error
    stamps = rows["stamp"] if unit == "ns" else _in_nanoseconds(rows["stamp"], unit, path)
    names = [f"c{i}" for i in range(1, len(columns))]
    values = np.column_stack([rows[name] for name in names]) if names else np.empty((stamps.size, 0))
    return stamps, values


def _in_nanoseconds(stamps: Array, unit: str, path: Path) -> Stamps:
    factor = _UNITS["time"][unit]
    bad = np.flatnonzero(~(np.abs(stamps) < _LARGEST_STAMP / factor))
    if bad.size:
        guess = "is the unit right? [ns] perhaps" if bad.size == stamps.size else "repair or delete the row"
        raise fault(path, f"the stamp {stamps[bad[0]]:g} {unit} is no possible time; {guess}", int(bad[0]))
    whole = np.floor(stamps)
    # in two parts, for seconds since 1970 times 1e9 leave no digits behind the point
    return whole.astype(np.int64) * int(factor) + np.round((stamps - whole) * factor).astype(np.int64)


def _bad_row(body: str, columns: tuple[Column, ...], stamp_type: str, path: Path, error: ValueError) -> RecordingError:
    """Find the first row that cannot be read and say what is wrong with it."""
    for number, line in enumerate(body.split("\n"), start=2):
        row = line.split("#")[0]
        if not row:
            continue
        cells = row.split(",")
        if len(cells) != len(columns):
            got = f"{len(cells)} values" if row.strip() else "nothing but blanks"
            return RecordingError(
                f"{got}, expected {len(columns)} values as in the header; repair or delete the row",
                file=path,
                line=number,
            )
        for cell, column in zip(cells, columns, strict=True):
            expected = _not_read(cell.strip(), whole=column.index == 0 and stamp_type == "i8")
            if expected:
                return RecordingError(
                    f"'{cell.strip()[:40]}' in column {column.index + 1} ('{column.name}') is not {expected}",
                    file=path,
                    line=number,
                )
    return RecordingError(f"cannot be read as a table of numbers: {error}; look for odd characters", file=path)


def _not_read(cell: str, *, whole: bool) -> str:
    """Return what was expected in a cell, and the remedy, where it cannot be read; otherwise nothing."""
    if not whole:
        return "" if _is_number(cell) else "a number; repair or delete the row"
    if re.fullmatch(r"[-+]?\d+", cell):
        fits = len(cell) < 25 and abs(int(cell)) < _LARGEST_STAMP
        return "" if fits else "a time that fits 64 bits; repair or delete the row"
    if _is_number(cell):
        return "a whole number of nanoseconds; write whole ones, or the unit they are in: '#timestamp [s]'"
    return "a whole number of nanoseconds; repair or delete the row"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell

"""CSV tables with a header of names and units, as EuRoC writes them."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kreisel import spill
from kreisel._kernels.decimal_rows import read_rows
from kreisel.errors import RecordingError
from kreisel.formats.column_names import read_name
from kreisel.geometry.rotation import Array
from kreisel.recording.header import UNITS, plain_unit
from kreisel.recording.location import fault
from kreisel.recording.nanoseconds import in_nanoseconds
from kreisel.recording.recording import NO_STAMP, DataWarning, Stamps

_COLUMN = re.compile(r"^\s*#?\s*([^\[\]()]*?)\s*(?:[\[(]\s*([^\[\]()]*?)\s*[\])])?\s*$")
_BLOCK = 1 << 23  # bytes read at once
_EMPTY_CELL = re.compile(rb"(?:^(?=[ \t]*,)|(?<=,))[ \t]*(?=,|$)", re.MULTILINE)
_NO_STAMP_CELL = re.compile(rb"^[ \t]*(?:nan)?[ \t]*(?=,)", re.MULTILINE | re.IGNORECASE)
_MAX_LINE = 1 << 16  # bytes; a row of seven numbers has a hundred
_MAX_COLUMNS = 1000  # chosen: one stream has tens; a header line of 4 MB took 950 MB of memory
_MAX_STAMP = 9.0e18  # ns; a little below the largest number of 64 bits


@dataclass(frozen=True)
class Column:
    """A column's place in the table, its name and its unit (None where the header names none).

    `words` are the text of its first cell and that cell's line, where it is no number: the column is then not read.
    """

    index: int
    name: str
    unit: str | None
    words: tuple[str, int] | None = None


@dataclass(frozen=True)
class Table:
    """A table as read: header, stamps, numbers (n, columns, with a column for the stamps), warnings."""

    source: Path
    columns: tuple[Column, ...]
    stamps_ns: Stamps
    values: Array
    warnings: tuple[DataWarning, ...]

    def take(self, columns: list[Column], quantity: str) -> Array:
        """Return columns of one group (n, k), converted to SI by the units the header gives; see `with_units`.

        Raises
        ------
        RecordingError
            If a unit is not one of the quantity, or the unit of a column is not clear, or if a column has no numbers.
        """
        for column in columns:
            if column.words is not None:
                raise _no_number(*column.words, column, "a number; repair or delete the row", self.source)
        columns = self.with_units(columns)
        factors = np.array([self._factor(column, quantity) for column in columns])
        out = spill.room((self.stamps_ns.size, len(columns)), np.float64)
        with np.errstate(over="ignore"):  # the checks report an infinity
            for i, column in enumerate(columns):
                np.multiply(self.values[:, column.index], factors[i], out=out[:, i])
        return out

    def with_units(self, columns: list[Column]) -> list[Column]:
        """Return the columns of one group, each with its unit: a unit that is stated only once applies to all.

        Raises
        ------
        RecordingError
            If units differ and one column has none.
        """
        stated = list(dict.fromkeys(column.unit for column in columns if column.unit is not None))
        if not stated or all(column.unit is not None for column in columns):
            return columns
        if len(stated) > 1:
            names = ", ".join(
                f"'{column.name}' {'without unit' if column.unit is None else f'[{column.unit}]'}" for column in columns
            )
            raise RecordingError(
                f"the columns {names} belong together, and the unit of each is not clear; write the unit of "
                "each, or one for all",
                file=self.source,
                line=1,
            )
        return [replace(column, unit=stated[0]) for column in columns]

    def _factor(self, column: Column, quantity: str) -> float:
        known = UNITS[quantity]
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
    return ", ".join(f"[{unit}]" for unit in UNITS[quantity])


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
    columns: tuple[Column, ...] = ()
    warnings: list[DataWarning] = []
    rows: _Rows | None = None
    comma = False
    for text, line in _text_blocks(path, what, warnings):
        body = text
        if not columns:
            head, _, body = text.partition(b"\n")
            header = head.decode()
            if not header.strip():
                break
            columns = parse_header(header, path)
            comma = has_last_comma(header, body.partition(b"\n")[0].decode(), len(columns))
            line += 1
        if comma:
            body = LAST_COMMA.sub(b"", body)
        if body.strip():
            lines = _line_ends(body) + 1
            if rows is None:
                columns = without_words(columns, body, line)
                whole = time_unit(columns, path) == "ns"
                rows = _Rows(round(1.02 * path.stat().st_size / len(body) * lines) + 16, len(columns), whole)
            rows.read(body, lines, partial(parse_rows, body, columns, path, line))
    if not columns:
        raise RecordingError(f"is empty; expected {what} as CSV with a header line", file=path)
    if rows is None:
        raise RecordingError(f"has a header but no rows; expected {what}: record again", file=path)
    values = rows.values[: rows.count]
    unit = time_unit(columns, path)
    stamps = rows.stamps[: rows.count] if rows.whole else stamps_in_nanoseconds(values[:, 0], unit, path)
    return Table(path, columns, stamps, values, tuple(warnings))


LAST_COMMA = re.compile(rb",[ \t]*$", re.MULTILINE)
"""At the end of a line."""


def has_last_comma(header: str, row: str, columns: int) -> bool:
    """Return whether a comma stands after the last cell of rows, by the header or by the first of them."""
    own = row.rstrip()
    return header.rstrip().endswith(",") or (own.endswith(",") and own.count(",") == columns)


class _Rows:
    """Arrays for the rows of a table, as many as its size suggests: joining chunks would take twice the memory.

    Stamps that are whole numbers stand in an array of their own, for they may have more digits than other numbers.
    """

    def __init__(self, room: int, columns: int, whole: bool) -> None:
        self.whole = whole
        self.stamps = spill.room((room if whole else 0,), np.int64)
        self.values = spill.room((room, columns), np.float64)
        self.count = 0

    def read(self, body: bytes, lines: int, otherwise: Callable[[], NDArray[Any]]) -> None:
        """Read rows of numbers; if they are not regular ones, take the structured rows that `otherwise` returns."""
        end = self.count + lines
        if end > len(self.values):
            self.stamps = np.resize(self.stamps, 2 * end if self.whole else 0)
            self.values = np.resize(self.values, (2 * end, self.values.shape[1]))
        part = slice(self.count, end)
        found = read_rows(body, self.stamps[part], self.values[part])
        if found is None:
            rows = otherwise()
            found = len(rows)
            part = slice(self.count, self.count + found)
            self.values[part] = rows.view(np.float64).reshape(found, self.values.shape[1])
            if self.whole:
                self.stamps[part] = rows["stamp"]
        self.count += found


def _text_blocks(path: Path, what: str, warnings: list[DataWarning]) -> Iterator[tuple[bytes, int]]:
    """Yield a file's text, in UTF-8, in blocks of whole lines, and the number of their first line.

    A truncated last line is left out.
    """
    try:
        if not path.is_file():
            raise RecordingError(f"{_instead(path)}; expected {what} there", file=path)
        with path.open("rb") as file:
            left, done, line = b"", 0, 1
            while data := file.read(_BLOCK):
                _check_text(data, done + len(left), line, left, path)
                data = left + data
                _check_lines(data, line, path)
                # a line end may have two bytes, and this may be the first
                end = len(data) - 1 if data.endswith(b"\r") else len(data)
                cut = max(data.rfind(b"\n", 0, end), data.rfind(b"\r", 0, end)) + 1
                left = data[cut:]
                if cut:
                    text = _checked(data[:cut], done, line, what, path)
                    yield text, line
                    done, line = done + cut, line + _line_ends(text)
            if left:
                yield from _last_line(_checked(left, done, line, what, path), line, path, warnings)
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror}; check its permissions, or copy it again", file=path
        ) from error


def _line_ends(text: bytes) -> int:
    """Return the number of line feeds; far faster than `bytes.count` where lines are short."""
    return int(np.count_nonzero(np.frombuffer(text, dtype=np.uint8) == ord("\n")))


def _check_text(data: bytes, start: int, line: int, left: bytes, path: Path) -> None:
    """Raise an error for a zero byte, which no text contains."""
    where = data.find(b"\0")
    if where < 0:
        return
    guess = "text in UTF-16: save it as UTF-8" if start == 0 and data[:2] in (b"\xff\xfe", b"\xfe\xff") else (
        "binary, or damaged by a loss of power: keep the lines before it, or copy it again"
    )  # fmt: skip
    raise RecordingError(
        f"holds a zero byte (byte {start + where}), which no CSV does; it is {guess}",
        file=path,
        line=line + left.count(b"\n") + data.count(b"\n", 0, where),
    )


def _check_lines(data: bytes, line: int, path: Path) -> None:
    """Raise an error for a line that is longer than any row: reading it would take unlimited memory."""
    begin = 0
    while len(data) - begin > _MAX_LINE:
        end = max(data.rfind(mark, begin, begin + _MAX_LINE) for mark in (b"\n", b"\r"))
        if end < 0:
            raise RecordingError(
                f"a line of more than {_MAX_LINE} bytes, expected one row of numbers in each; is it another kind "
                "of file? Otherwise repair or delete the line",
                file=path,
                line=line + data.count(b"\n", 0, begin),
            )
        begin = end + 1


def _checked(data: bytes, start: int, line: int, what: str, path: Path) -> bytes:
    """Return bytes that are text in UTF-8, with plain line ends."""
    if not data.isascii():
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise RecordingError(
                f"not UTF-8 text (byte {start + error.start}); expected {what} as CSV: save it in UTF-8",
                file=path,
                line=line + data.count(b"\n", 0, error.start),
            ) from error
        if start == 0:
            data = data.removeprefix("\ufeff".encode())
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _last_line(text: bytes, line: int, path: Path, warnings: list[DataWarning]) -> Iterator[tuple[bytes, int]]:
    """Yield a last line that has an end; drop one without: it may be incomplete, as after a recorder was stopped."""
    if text.endswith(b"\n") or line == 1:
        yield text, line
        return
    name = f"{path.parent.name}/{path.name}"
    warnings.append(without_end(name, text.decode()))


def without_end(name: str, line: str) -> DataWarning:
    """Return the warning about a last line without an end, which is left out of the table of a name."""
    return DataWarning(name, f"the last line has no end ('{line[-40:]}'): it may be cut and was left out")


def _instead(path: Path) -> str:
    """Return a text of what is at the place of a file."""
    if path.is_dir():
        return "is a folder, not a file"
    if path.is_symlink():
        return "is a link to a missing file"
    return "is not a regular file" if path.exists() else "no such file"


def parse_header(header: str, path: Path) -> tuple[Column, ...]:
    """Return the columns that a header line names.

    Raises
    ------
    RecordingError
        If it is no header, or is divided by other marks than commas.
    """
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
    if header.count(",") >= _MAX_COLUMNS:
        raise RecordingError(
            f"{header.count(',') + 1} columns, expected {_MAX_COLUMNS} at most; keep those of one stream",
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
        columns.append(Column(i, match.group(1), _unit_after(match.group(1)) if unit is None else plain_unit(unit)))
    return tuple(columns)


def _unit_after(name: str) -> str | None:
    """Return the unit at the end of a name, as of gyro_x_dps, None where there is none."""
    said = read_name(name)
    return said.unit if said.quantity in ("time", "rate", "acceleration", "position") else None


def time_unit(columns: tuple[Column, ...], path: Path) -> str:
    """Return the unit of the stamps in the first column; nanoseconds where the header states none.

    Raises
    ------
    RecordingError
        If it is no unit of time.
    """
    unit = columns[0].unit or "ns"
    if unit not in UNITS["time"]:
        raise RecordingError(
            f"stamps are in [{unit}]; kreisel reads {_listed('time')}. Convert them, or correct the header",
            file=path,
            line=1,
        )
    return unit


def parse_rows(body: bytes, columns: tuple[Column, ...], path: Path, line: int) -> NDArray[Any]:
    """Return rows with comments or unusual numbers, (n,) structured; `line` is the line of the first in the file.

    Raises
    ------
    RecordingError
        For the first row that cannot be read.
    """
    if b"#" in body:
        _check_comments(body, columns, path, line)
    stamp_type = "i8" if time_unit(columns, path) == "ns" else "f8"
    of_cells = ["f8" if column.words is None else "U1" for column in columns[1:]]
    dtype = np.dtype([("stamp", stamp_type)] + [(f"c{i}", kind) for i, kind in enumerate(of_cells, 1)])
    # a StringIO would keep four bytes a character and be read three times slower
    text = io.TextIOWrapper(io.BytesIO(_with_empty_cells(body, stamp_type)), encoding="utf-8")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # rows of only comments need no warning
            rows = np.atleast_1d(np.loadtxt(text, delimiter=",", dtype=dtype))
    except ValueError as error:
        raise _bad_row(body.decode(), columns, stamp_type, path, error, line) from error
    if "U1" not in of_cells:
        return rows
    out = np.empty(len(rows), [("stamp", stamp_type), *((f"c{i}", "f8") for i in range(1, len(columns)))])
    for name, kind in zip(dtype.names or (), [stamp_type, *of_cells], strict=True):
        out[name] = np.nan if kind == "U1" else rows[name]
    return out


def without_words(columns: tuple[Column, ...], body: bytes, line: int) -> tuple[Column, ...]:
    """Return columns with those marked whose cell in the first row is no number; `line` is the line of the first."""
    for number, text in enumerate(body.split(b"\n"), line):
        cells = [cell.strip() for cell in text.partition(b"#")[0].decode().split(",")]
        if len(cells) == len(columns) and any(cells):
            return tuple(
                replace(one, words=(cell, number)) if one.index > 0 and cell and not is_number(cell) else one
                for one, cell in zip(columns, cells, strict=True)
            )
    return columns


def _no_number(cell: str, line: int, column: Column, expected: str, path: Path) -> RecordingError:
    """Return the error about a cell that is not what was expected."""
    text = f"'{cell[:40]}' in column {column.index + 1} ('{column.name}') is not {expected}"
    return RecordingError(text, file=path, line=line)


def _check_comments(body: bytes, columns: tuple[Column, ...], path: Path, line: int) -> None:
    """Raise an error for a comment that is a header, but not the first one: units may be others from there on."""
    for number, text in enumerate(body.split(b"\n"), line):
        if not text.lstrip().startswith(b"#") or text.count(b",") < len(columns) - 1:
            continue
        try:
            other = parse_header(text.decode(), path)
        except RecordingError:
            continue
        if other != columns and any(column.unit is not None for column in other):
            said = text.decode().strip()[:60]
            raise RecordingError(
                f"another header ('{said}') than that of the first line; split the file there", file=path, line=number
            )


def _with_empty_cells(body: bytes, stamp_type: str) -> bytes:
    """Return rows with NaN in the place of empty cells, and stamps that are not times."""
    if stamp_type == "i8":
        body = _NO_STAMP_CELL.sub(str(NO_STAMP).encode(), body)
    return _EMPTY_CELL.sub(b"nan", body)


def stamps_in_nanoseconds(stamps: Array, unit: str, path: Path) -> Stamps:
    """Return stamps in a unit as nanoseconds, NO_STAMP where there is none.

    Raises
    ------
    RecordingError
        If one is not a possible time.
    """
    factor = UNITS["time"][unit]
    known = ~np.isnan(stamps)
    bad = np.flatnonzero(known & ~(np.abs(stamps) < _MAX_STAMP / factor))
    if bad.size:
        guess = (
            f"is the unit right? {_likely(stamps)} perhaps" if bad.size == stamps.size else ("repair or delete the row")
        )
        raise fault(path, f"the stamp {stamps[bad[0]]:g} {unit} is not a possible time; {guess}", int(bad[0]))
    if known.all():
        return in_nanoseconds(stamps, factor)
    return np.where(known, in_nanoseconds(np.where(known, stamps, 0.0), factor), NO_STAMP)


def _likely(stamps: Array) -> str:
    """Return the unit or units in which the rate of stamps is one that devices have."""
    with np.errstate(invalid="ignore", over="ignore"):
        step = float(np.median(np.diff(stamps))) if stamps.size > 1 else np.nan
    fitting = [unit for unit, size in UNITS["time"].items() if 0.5 <= 1e9 / max(step * size, 1e-300) <= 20e3]
    return " or ".join(f"[{unit}]" for unit in fitting or ["ns"])


def _bad_row(
    body: str, columns: tuple[Column, ...], stamp_type: str, path: Path, error: ValueError, first: int
) -> RecordingError:
    """Return the error for the first row that cannot be read."""
    for number, line in enumerate(body.split("\n"), start=first):
        row = line.split("#")[0]
        if not row:
            continue
        cells = row.split(",")
        if len(cells) != len(columns):
            got = f"{len(cells)} values" if row.strip() else "only blanks"
            return RecordingError(
                f"{got}, expected {len(columns)} values as in the header; repair or delete the row",
                file=path,
                line=number,
            )
        for cell, column in zip(cells, columns, strict=True):
            expected = _not_read(cell.strip(), _stamps_in(body) if column.index == 0 and stamp_type == "i8" else None)
            if expected and column.words is None:
                return _no_number(cell.strip(), number, column, expected, path)
    return RecordingError(f"cannot be read as a table of numbers: {error}; look for unusual characters", file=path)


def _stamps_in(body: str) -> Array:
    """Return the first numbers in the first column of some rows."""
    cells = [line.partition(",")[0].strip() for line in body.split("\n", 500)[:500]]
    return np.array([float(cell) for cell in cells if is_number(cell)])


def _not_read(cell: str, whole: Array | None) -> str:
    """Return what was expected in a cell that cannot be read, and the remedy; empty if it can be read.

    Parameters
    ----------
    whole
        Stamps around it, where it must be a whole number of nanoseconds.
    """
    if whole is None:
        return "" if is_number(cell) or not cell else "a number; repair or delete the row"
    if cell.lower() in ("", "nan"):
        return ""
    if re.fullmatch(r"[-+]?\d+", cell):
        fits = len(cell) < 25 and abs(int(cell)) < _MAX_STAMP
        return "" if fits else "a time that fits 64 bits; repair or delete the row"
    if is_number(cell):
        unit = _likely(whole).partition(" or ")[0]
        return f"a whole number of nanoseconds; write whole ones, or the unit they are in: '#timestamp {unit}'"
    return "a whole number of nanoseconds; repair or delete the row"


def is_number(cell: str) -> bool:
    """Return whether a cell's text is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell

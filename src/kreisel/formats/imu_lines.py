"""Tables of IMU readings line by line, as they come from a file or through a pipe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.csv_table import (
    LAST_COMMA,
    Column,
    Table,
    has_last_comma,
    parse_header,
    parse_rows,
    stamps_in_nanoseconds,
    time_unit,
    without_words,
)
from kreisel.formats.folder import imu_columns, temperature_of
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, Stamps

_EXPECTED = "#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z"
_LONGEST = 1 << 16  # bytes of a line


@dataclass(frozen=True)
class ImuRows:
    """Some rows of a table of readings.

    Attributes
    ----------
    stamps_ns : (n,)
    rates, accelerations : (n, 3)
        rad/s and m/s^2.
    temperature : (n,) or None
        Degrees Celsius.
    stamp_texts, others
        The stamps as they were written, and what stood after the readings, with its comma.
    """

    stamps_ns: Stamps
    rates: Array
    accelerations: Array
    temperature: Array | None
    stamp_texts: list[str]
    others: list[str]


class ImuLines:
    """A table of readings whose bytes come one block after the other.

    Parameters
    ----------
    source
        The file, or a name of the stream, for messages.
    packets
        Whether rows may have the stamp of the one before, as those of one packet have.

    Attributes
    ----------
    header
        Header of the stamps, and that of columns after the readings with its comma; None before it came.
    notes
        What to know about the columns.
    missing, first_missing
        Number of rows without a number (NaN, or an empty cell), which are left out, and the line of the first.
    """

    def __init__(self, source: Path, *, packets: bool = False) -> None:
        self._source, self._packets = source, packets
        self._columns: tuple[Column, ...] = ()
        self._head = ""
        self._comma: bool | None = None
        self._left = b""
        self._line = 1
        self._last: int | None = None
        self._unreadable: RecordingError | None = None
        self.notes: list[DataWarning] = []
        self.missing, self.first_missing = 0, 0
        self.header: tuple[str, str] | None = None

    def feed(self, data: bytes) -> ImuRows | None:
        """Return the rows that are complete after more bytes; None where there are none.

        Raises
        ------
        RecordingError
            If the header or a row cannot be read; it names the line. The rows before it are returned first: then the
            next call raises.
        """
        if self._unreadable is not None:
            raise self._unreadable
        data = self._left + data
        if b"\r" in data:  # a last one may be half of a line end
            data = data[:-1].replace(b"\r\n", b"\n").replace(b"\r", b"\n") + data[-1:]
            data = data.replace(b"\r\n", b"\n")
        cut = data.rfind(b"\n") + 1
        self._left = data[cut:]
        if len(self._left) > _LONGEST:
            raise self._fault(f"a line of more than {_LONGEST} bytes; expected one row of numbers in each")
        return self._readable(data[:cut]) if cut else None

    @property
    def ends_with_return(self) -> bool:
        """Whether the last byte so far may be a line end, or the half of one."""
        return self._left.endswith(b"\r")

    def close(self) -> str | None:
        """Return the text of a last line that has no end, which is left out; None where there is none.

        Raises
        ------
        RecordingError
            If there was no header, or for a row that `feed` could not read.
        """
        if self._unreadable is not None:
            raise self._unreadable
        if not self._columns:
            raise self._fault(f"is empty; expected IMU readings as CSV with the header {_EXPECTED}")
        return self._left.decode(errors="replace").strip() or None

    def _readable(self, text: bytes) -> ImuRows | None:
        """Return the rows of a text, or those before one that cannot be read."""
        begin, last, columns, missing = self._line, self._last, self._columns, self.missing
        try:
            return self._rows(text)
        except RecordingError as error:
            before = b"".join(text.splitlines(keepends=True)[: max((error.line or 0) - begin, 0)])
            if before.count(b"\n") <= (begin == 1):  # not more than the header
                raise
            self._line, self._last, self._unreadable = begin, last, error
            self._columns, self.missing = columns, missing
            return self._rows(before)

    def _rows(self, text: bytes) -> ImuRows | None:
        begin, self._line = self._line, self._line + text.count(b"\n")
        try:
            lines = text.decode("utf-8-sig" if begin == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise self._fault(f"not UTF-8 text (byte {error.start} of these lines)", begin) from error
        if not self._columns:
            head, _, lines = lines.partition("\n")
            begin += 1
            self._read_header(head)
        if self._comma is None and lines.strip():
            first = next(line for line in lines.split("\n") if line.strip())
            self._comma = has_last_comma(self._head, first, len(self._columns))
        if self._last is None:
            self._columns = without_words(self._columns, lines.encode(), begin)
        if self._comma:
            lines = LAST_COMMA.sub(b"", lines.encode()).decode()
        numbered = [(begin + i, line) for i, line in enumerate(lines.split("\n"))]
        rows = [(number, plain) for number, line in numbered if (plain := line.partition("#")[0]).strip()]
        if not rows:
            return None
        found = parse_rows(lines.encode(), self._columns, self._source, begin)
        numbers = [number for number, _ in rows]
        if len(found) != len(rows):
            raise self._fault(f"{len(rows)} lines with {len(found)} rows; expected one row in each", begin)
        values = found.view(np.float64).reshape(len(found), len(self._columns))
        known = np.flatnonzero(~np.isnan(values[:, 1:7].sum(axis=1)))
        if known.size < len(rows):
            self.first_missing = self.first_missing or int(np.delete(numbers, known)[0])
            self.missing += len(rows) - known.size
            rows, found, values = [rows[k] for k in known], found[known], values[known]
            numbers = [number for number, _ in rows]
            if not rows:
                return None
        unit = time_unit(self._columns, self._source)
        stamps = found["stamp"] if unit == "ns" else stamps_in_nanoseconds(values[:, 0], unit, self._source)
        self._check_ascending(stamps, numbers)
        notes: list[DataWarning] = []
        table = Table(self._source, self._columns, np.ascontiguousarray(stamps), values, ())
        gyro, accel = imu_columns(table)
        temperature = temperature_of(table, notes)
        self.notes = self.notes or notes
        parts = [row.split(",", 7) for _, row in rows]
        return ImuRows(
            table.stamps_ns,
            self._finite(table.take(gyro, "rate"), numbers),
            self._finite(table.take(accel, "acceleration"), numbers),
            temperature,
            [part[0].strip() for part in parts],
            [f",{part[7].strip()}" if len(part) > 7 else "" for part in parts],
        )

    def _read_header(self, head: str) -> None:
        columns = parse_header(head, self._source)
        if len(columns) < 7:
            raise self._fault(f"{len(columns)} columns, expected 7 or more: {_EXPECTED}", 1)
        empty = Table(self._source, columns, np.zeros(0, dtype=np.int64), np.zeros((0, len(columns))), ())
        for group, quantity in zip(imu_columns(empty), ("rate", "acceleration"), strict=True):
            empty.take(group, quantity)
        time_unit(columns, self._source)
        self._head = head
        cells = head.strip().rstrip(",").split(",")
        self._columns, self.header = columns, (cells[0], "".join(f",{cell}" for cell in cells[7:]))

    def _check_ascending(self, stamps: Stamps, numbers: list[int]) -> None:
        before = np.concatenate([[stamps[0] - 1 if self._last is None else self._last], stamps[:-1]])
        bad = np.flatnonzero(stamps < before if self._packets else stamps <= before)
        if bad.size:
            k = int(bad[0])
            raise self._fault(f"the stamp {stamps[k]} ns does not follow {before[k]} ns; expected ascending stamps",
                              numbers[k])  # fmt: skip
        self._last = int(stamps[-1])

    def _finite(self, values: Array, numbers: list[int]) -> Array:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise self._fault("a reading is not a finite number; repair or delete the row", numbers[int(bad[0])])
        return values

    def _fault(self, message: str, line: int | None = None) -> RecordingError:
        return RecordingError(message, file=self._source, line=line)

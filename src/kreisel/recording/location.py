"""The place of a fault in a stream, as a line of a table or a message of a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from kreisel.errors import RecordingError
from kreisel.recording.header import HeaderUnits, named

ARRAYS = Path("<arrays>")
"""Source of streams that did not come from a file."""


class Stream(Protocol):
    """Part of a recording: the file it came from, and the units that its header states."""

    @property
    def source(self) -> Path:
        """File, or bag and topic."""

    @property
    def units(self) -> HeaderUnits:
        """Units that the file's header states."""


def is_table(source: Path) -> bool:
    """Return whether a stream came from a CSV table; streams of bags are named by file and topic."""
    return source.suffix.lower() == ".csv"


def is_mapped(source: Path) -> bool:
    """Return whether a stream came from arrays, or from columns of another table: TABLE/imu, /reference, /joints."""
    named = source.name in ("imu", "reference", "joints")
    return named and (source.parent == ARRAYS or (bool(source.parent.suffix) and source.parent.is_file()))


def fault(source: Path, message: str, row: int | None = None) -> RecordingError:
    """Return the error for a fault at a row, counted from 0, or for one of the whole stream."""
    if row is None:
        return RecordingError(message, file=source)
    if is_table(source):
        return RecordingError(message, file=source, line=line_of(source, row))
    return RecordingError(f"{'row' if is_mapped(source) else 'message'} {row + 1}: {message}", file=source)


def header_fault(source: Path, message: str) -> RecordingError:
    """Return the error for a fault of all rows, or of a whole column: of a table, at its header."""
    return RecordingError(message, file=source, line=1 if is_table(source) else None)


def wrong_unit(stream: Stream, message: str, quantity: str, factor: float, otherwise: str = "") -> RecordingError:
    """Return the error for numbers that look like another unit than the one they are read in.

    Parameters
    ----------
    factor
        Factor by which the numbers, as read into SI, must be multiplied to be right.
    otherwise
        The unit they seem to be in, where a header may not state it.
    """
    source, stated = stream.source, getattr(stream.units, quantity)
    si, size = {"rate": "rad/s", "acceleration": "m/s^2", "length": "m"}[quantity], stream.units.size(quantity)
    unit = named(quantity, size * factor)
    times = f"{1.0 / factor if factor < 1.0 else factor:.4g} times too {'large' if factor < 1.0 else 'small'}"
    looks = f"they look like [{unit or otherwise}]" if unit or otherwise else f"they are {times}"
    if is_mapped(source):
        if source.parent == ARRAYS:
            return RecordingError(f"{message}: {looks}; give them in {si}", file=source)
        if not unit and not otherwise:
            remedy = f"in [{stated or si}] {looks}; write the right unit after the columns in the mapping"
            return RecordingError(f"{message}: {remedy}", file=source)
        remedy = f"they are read in [{stated or si}], but {looks}; write that unit after the columns in the mapping"
        return RecordingError(f"{message}: {remedy}", file=source)
    if not is_table(source):
        return RecordingError(f"{message}: {looks}; ROS messages are in {si}: convert them", file=source)
    if stated is None:
        known = f"write [{unit}] into the header, or convert to {si}" if unit else f"convert them to {si}"
        return RecordingError(f"{message}: {looks}; {known}", file=source, line=1)
    seem = looks if unit or (otherwise and size == 1.0) else f"the numbers look {times} for it"
    return RecordingError(
        f"{message}: the header says [{stated}], but {seem}; correct the header or the numbers", file=source, line=1
    )


def rows(source: Path) -> str:
    """Return the word for the rows of a stream: rows of a table, messages of a bag."""
    return "rows" if is_table(source) or is_mapped(source) else "messages"


def at(source: Path, row: int) -> str:
    """Return the place of a row, counted from 0, for a warning."""
    if is_table(source):
        return f"line {line_of(source, row)}"
    return f"{'row' if is_mapped(source) else 'message'} {row + 1}"


def line_of(source: Path, row: int) -> int:
    """Return the line that a row of a table is in; empty lines and comments are not rows."""
    try:
        with source.open(encoding="utf-8-sig") as file:
            next(file, None)
            seen = -1
            for number, line in enumerate(file, start=2):
                text = line.partition("#")[0].strip()
                seen += bool(text)
                if seen == row:
                    return number
    except (OSError, UnicodeDecodeError):
        pass
    return row + 2


def and_more(count: int, what: str) -> str:
    """Return ', and in 3 more rows' for a count of further faults; nothing where there is none."""
    if count < 1:
        return ""
    return f", and in {count} more {what if count > 1 else what.removesuffix('s')}"

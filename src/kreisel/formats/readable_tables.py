"""The tables of a folder that can be read, and why others cannot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kreisel.errors import RecordingError
from kreisel.formats.mapped import tables_in
from kreisel.formats.sheet import Sheet, read_sheet
from kreisel.progress import Progress

_NOTES = 4096
"""Bytes up to which a file that cannot be read may be somebody's notes."""


def readable(path: Path, progress: Progress) -> tuple[list[Sheet], list[RecordingError]]:
    """Return the tables that can be read, and why others beside them cannot.

    Raises
    ------
    RecordingError
        If none can be read.
    """
    found: list[Sheet] = []
    errors: list[RecordingError] = []
    files = tables_in(path)
    for k, file in enumerate(files):
        progress("read tables", k / len(files))
        try:
            found.append(read_sheet(file))
        except RecordingError as error:
            errors.append(error)
    if errors and not found:
        raise errors[0]
    return found, errors


def in_words(error: RecordingError) -> str:
    """Return what an error says, with its file and line."""
    name = "" if error.file is None or not Path(error.file).is_file() else f"{Path(error.file).name}: "
    return f"{name}{error.message}" if error.line is None else f"{name}line {error.line}: {error.message}"


def _size(error: RecordingError) -> int:
    """Return the size of the file that an error is about: recordings are larger than notes."""
    return 0 if error.file is None else Path(error.file).stat().st_size


def most_likely(errors: Sequence[RecordingError]) -> RecordingError:
    """Return the error about the largest file."""
    return max(errors, key=_size)


def notes_of(errors: Sequence[RecordingError]) -> list[str]:
    """Return what is said of files that cannot be read, the largest first."""
    return [in_words(error) for error in sorted(errors, key=_size, reverse=True) if _size(error) > _NOTES]

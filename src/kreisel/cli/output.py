"""Checks of the output folder before the work begins, so that no result is lost at its end."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kreisel.errors import RecordingError, SettingsError
from kreisel.files import open_lock


def check_output(folder: Path) -> None:
    """Check that the output folder exists or can be made.

    Raises
    ------
    RecordingError
        If the path is a file, or cannot be written; the message says why.
    """
    if folder.exists() and not folder.is_dir():
        raise RecordingError("is a file; give a folder for the result", file=folder)
    new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # a name that nobody can have put a link at
            pass
        if new:
            folder.rmdir()  # a command that fails leaves nothing
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}; choose another -o", file=folder) from error


@contextmanager
def alone_in(output: Path, other: str = "batch") -> Iterator[None]:
    """Keep other commands of a kind out of a folder, where the system has locks.

    Raises
    ------
    SettingsError
        If one is at work there.
    """
    with open_lock(output / ".lock") as file:
        try:
            with suppress(ImportError):
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            busy = f"-o {output}: another {other} is at work there; wait for it, or give another folder"
            raise SettingsError(busy) from error
        yield

"""Check of the output folder before the work begins, so that no result is lost at its end."""

from __future__ import annotations

import tempfile
from pathlib import Path

from kreisel.errors import RecordingError


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

"""Where results go: checked before work begins, so that none is lost after it."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError


def check_output(folder: Path) -> None:
    """Look whether the output folder is there or can be made, or say why not.

    Raises
    ------
    RecordingError
        If the path is a file, or may not be written.
    """
    if folder.exists() and not folder.is_dir():
        raise RecordingError("is a file; give a folder for the result", file=folder)
    new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".kreisel-probe"
        probe.write_bytes(b"")
        probe.unlink()
        if new:
            folder.rmdir()  # what fails leaves nothing behind
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}; choose another -o", file=folder) from error

"""The robot's description in the folder of a recording."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError
from kreisel.files import read_text
from kreisel.recording.recording_settings import RecordingSettings


def description_beside(folder: Path, settings: RecordingSettings) -> str | None:
    """Return the text of the robot's description in a folder, or None where there is none."""
    file = folder / (settings.robot.urdf or "robot.urdf")
    if not is_there(file):
        return None
    try:
        return read_text(file)
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise RecordingError(
            f"cannot be read as text ({why}); expected a robot's description (URDF): copy it again, or delete "
            "robot.urdf",
            file=file,
        ) from error


def is_there(path: Path) -> bool:
    """Return whether the path exists, even if only as a link without target."""
    return path.is_symlink() or path.exists()

"""The recordings in a folder, and what identifies the work on each."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from kreisel._version import __version__
from kreisel.errors import RecordingError
from kreisel.formats.folder import is_folder
from kreisel.formats.loading import is_bag
from kreisel.model.settings import CalibrationSettings

_FILES = (".mcap", ".bag", ".db3")


@dataclass(frozen=True)
class Job:
    """One recording to calibrate.

    Attributes
    ----------
    name
        Path below the folder, with slashes.
    key
        Fingerprint of the recording's files (names, sizes, times of change), the settings and the version.
    """

    name: str
    path: Path
    key: str


def jobs_in(folder: Path, out: Path, settings: CalibrationSettings) -> list[Job]:
    """Return the recordings below a folder, by name; `out` is left out.

    Raises
    ------
    RecordingError
        If the folder does not exist or holds no recording.
    """
    if not folder.is_dir():
        raise RecordingError("no such folder; give the one that holds the recordings", file=folder)
    out = out.resolve()
    found = sorted(_recordings(folder, out))
    if not found:
        raise RecordingError("holds no recordings (folders with imu0, .mcap files, bags, or tables with [columns])",
                             file=folder)  # fmt: skip
    return [Job(path.relative_to(folder).as_posix(), path, _key(path, settings)) for path in found]


def _recordings(folder: Path, out: Path) -> list[Path]:
    found = []
    for path in folder.iterdir():
        if path.name.startswith(".") or path.resolve() == out:
            continue
        if path.is_file():
            if path.suffix.lower() in _FILES:
                found.append(path)
        elif is_folder(path) or is_bag(path) or (path / "recording.toml").is_file():
            found.append(path)
        elif path.is_dir():
            found += _recordings(path, out)
    return found


def _key(path: Path, settings: CalibrationSettings) -> str:
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    own = hashlib.sha256(f"{__version__} {settings!r}".encode())
    for file in files:
        facts = file.stat()
        own.update(f"{file.relative_to(path.parent).as_posix()} {facts.st_size} {facts.st_mtime_ns}\n".encode())
    return own.hexdigest()

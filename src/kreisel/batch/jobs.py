"""The recordings in a folder, and what identifies the work on each."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kreisel._version import __version__
from kreisel.batch.job_result import key_of_unit
from kreisel.errors import KreiselError, RecordingError, SettingsError
from kreisel.formats.input_formats import SUFFIXES, format_of
from kreisel.model.calibration_settings import CalibrationSettings

MEAN = "mean"
"""Folder of the mean of the units of a tray."""

TRAY_FILES = ("array.yaml", "covariance.csv", "units_covariance.npz", "report.html")
"""Files of a tray beside the folders of its units and of their mean."""


@dataclass(frozen=True)
class Job:
    """One recording to calibrate, of one unit or of a tray.

    Attributes
    ----------
    name
        Path below the folder, with slashes.
    key
        Fingerprint of the recording's name, of names and content of its files, the settings and the version.
    imus
        Names of the IMUs of a tray; empty for a recording of one unit.
    """

    name: str
    path: Path
    key: str
    imus: tuple[str, ...] = ()

    @property
    def runs(self) -> dict[str, str]:
        """The names of its runs by their keys, one for each unit; they are also those of the result folders."""
        if not self.imus:
            return {self.key: self.name}
        return {key_of_unit(self.key, imu): f"{self.name}/{imu}" for imu in self.imus}


def jobs_in(folder: Path, out: Path, settings: CalibrationSettings, *, links: bool = False) -> list[Job]:
    """Return the recordings below a folder, by name; `out` is left out.

    Parameters
    ----------
    links
        Whether links that lead out of the folder are followed: they could lead anywhere.

    Raises
    ------
    RecordingError
        If the folder does not exist or holds no recording.
    SettingsError
        If the settings are not for trays, and one of the recordings is of a tray.
    """
    if not folder.is_dir():
        raise RecordingError("no such folder; give the one that holds the recordings", file=folder)
    out = out.resolve()
    found = sorted(_recordings(folder, out, frozenset(), None if links else Path(os.path.realpath(folder))))
    if not found:
        more = "; links out of it are not followed without --links" if leaving(folder) and not links else ""
        raise RecordingError(
            f"holds no recordings (folders with imu0, .mcap files, bags, or tables with [columns]){more}", file=folder
        )
    names = [path.relative_to(folder).as_posix() for path in found]
    units = [_units_in(path) for path in found]
    if trays := [name for name, own in zip(names, units, strict=True) if own]:
        _check_trays(trays, settings)
    return [
        Job(name, path, _key(name, path, settings), own) for name, path, own in zip(names, found, units, strict=True)
    ]


def _units_in(path: Path) -> tuple[str, ...]:
    """Return the names of the IMUs if there are several."""
    from kreisel.formats.imus import imus_in

    try:
        found = imus_in(path)
    except KreiselError:
        return ()  # its calibration will say so
    return found if len(found) > 1 else ()


def _check_trays(names: list[str], settings: CalibrationSettings) -> None:
    from kreisel.array.tray import check_settings

    try:
        check_settings(settings)
    except SettingsError as error:
        reason = str(error).partition(";")[0]
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        raise SettingsError(
            f"{reason}, and the folder has trays ({', '.join(names[:3])}{more}); leave it out, or calibrate their "
            "units one by one by `kreisel calibrate --imu`"
        ) from error


def leaving(folder: Path) -> list[str]:
    """Return the names of the links below a folder that lead out of it."""
    root = Path(os.path.realpath(folder))
    return sorted(
        (Path(here) / name).relative_to(folder).as_posix()
        for here, folders, files in os.walk(folder)
        for name in (*folders, *files)
        if (Path(here) / name).is_symlink() and not _below(Path(here) / name, root)
    )


def _below(path: Path, root: Path | None) -> bool:
    return root is None or Path(os.path.realpath(path)).is_relative_to(root)


def _recordings(folder: Path, out: Path, above: frozenset[str], root: Path | None) -> list[Path]:
    """Return the recordings below a folder; links are followed, but not back to a folder above, nor out of `root`."""
    found: list[Path] = []
    here = os.path.realpath(folder)
    if here in above:
        return found
    for path in _entries(folder):
        if path.name.startswith(".") or os.path.realpath(path) in above | {here, str(out)} or not _below(path, root):
            continue
        if path.is_file():
            if path.suffix.lower() in SUFFIXES:
                found.append(path)
        elif format_of(path) is not None or (path / "recording.toml").is_file():
            found.append(path)
        elif path.is_dir():
            found += _recordings(path, out, above | {here}, root)
    return found


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}; check its permissions", file=folder) from error


def _key(name: str, path: Path, settings: CalibrationSettings) -> str:
    own = hashlib.sha256(f"{__version__} {settings!r} {name}".encode())
    beside = path.with_suffix(".toml")  # settings of a file
    settings_files = [beside] if path.is_file() and beside.is_file() else []
    for file in (*sorted(_files(path, frozenset())), *settings_files):
        own.update(f"\n{file.name if file is beside else file.relative_to(path).as_posix()} ".encode())
        try:
            with file.open("rb") as content:
                own.update(hashlib.file_digest(content, "sha256").digest())
        except OSError as error:
            own.update(f"{error.strerror}".encode())  # its calibration will say so
    return own.hexdigest()


def _files(path: Path, above: frozenset[str]) -> Iterator[Path]:
    if path.is_file():
        yield path
    elif path.is_dir() and (here := os.path.realpath(path)) not in above:
        for entry in _entries(path):
            yield from _files(entry, above | {here})

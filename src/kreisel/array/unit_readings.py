"""The recordings of single IMUs of one recording, and the first of them that can be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from kreisel.array.left_out import reason_of
from kreisel.errors import KreiselError, RecordingError
from kreisel.formats.folder import is_folder
from kreisel.formats.imus import imu_reader
from kreisel.recording.recording import Recording
from kreisel.validation.checks import check_streams


def first_readable(
    read: Callable[[str], Recording], path: Path, names: Sequence[str], unread: dict[str, str]
) -> tuple[Recording, Sequence[str]]:
    """Return the recording with the first IMU that can be read, and the names from it on.

    Parameters
    ----------
    read
        Returns the recording with the readings of one IMU.
    unread
        Filled with the reasons why those before it cannot be read.

    Raises
    ------
    KreiselError
        If none or only the last one can be read, or something else in a folder cannot.
    """
    for k, name in enumerate(names[:-1]):
        try:
            return read(name), names[k:]
        except KreiselError as error:
            if is_folder(path) and name not in Path(getattr(error, "file", None) or "").parts:
                raise
            unread[name] = reason_of(error)
    read(names[-1])
    raise RecordingError(
        f"of its {len(names)} IMUs only {names[-1]} can be read, expected two or more; `kreisel calibrate --imu "
        f"{names[-1]}` calibrates it alone",
        file=path,
    )


def unit_reader(base: Recording, first: str) -> Callable[[str], Recording]:
    """Return what reads the recordings of single IMUs of a recording, with the reference of the first one's.

    Its function raises a RecordingError if readings cannot be read, or are not possible.

    Parameters
    ----------
    base, first
        The recording with the readings of the first IMU, and the name of this IMU.
    """
    read_imu, moved = imu_reader(base.path), base.reference is not None

    def read(name: str) -> Recording:
        if name == first:
            return base
        imu, warnings = read_imu(name)
        alone = Recording(base.path, imu, None, settings=base.settings.of_imu(name), warnings=warnings)
        return replace(check_streams(alone, moved=moved), reference=base.reference, joints=base.joints, urdf=base.urdf)

    return read

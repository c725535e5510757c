"""The IMUs of a recording of any form: which there are, and the readings of one of them."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError, SettingsError
from kreisel.formats.input_formats import ReadImu, format_of

ALL = "all"
"""Asks for all IMUs of a recording in place of the name of one."""


def imus_in(path: Path, imu: str | None = None) -> tuple[str, ...]:
    """Return the names of the units in a recording: imu0, imu1, … in the order of their numbers.

    Parameters
    ----------
    imu
        `all` asks for all IMUs in a bag. By default they are those on the topics that kreisel writes, or the only one:
        IMUs in a bag of others need not be on one body. In a folder they are always all.

    Returns
    -------
    tuple of str
        Empty where there are several IMUs, of which one must be chosen, and where columns of a table need a mapping.

    Raises
    ------
    RecordingError
        If it cannot be read, or holds no several IMUs where all are asked for.
    SettingsError
        If one IMU is asked for.
    """
    if imu not in (None, ALL):
        raise SettingsError(f"--imu {imu}: expected '{ALL}'; leave it out for the units of one recording")
    if not path.exists():
        raise RecordingError("no such file or folder; give a folder, an .mcap file or a bag", file=path)
    form = format_of(path)
    names = _mapped(path) or (() if form is None else form.units(path, imu == ALL))
    if imu == ALL and len(names) < 2:
        count = "one IMU" if names else "no IMU"
        raise RecordingError(f"holds {count}, expected several; leave out --imu {ALL}", file=path)
    return names


def imu_reader(path: Path) -> ReadImu:
    """Return what reads the readings of one IMU by its name, as they were recorded, and what was found in them.

    Its function raises a RecordingError if there is no such IMU, or it cannot be read. In a bag all IMUs have names:
    see `imus_in`. Several threads may call it at the same time for a folder, not for a bag.

    Raises
    ------
    RecordingError
        If there is no recording.
    """
    if _mapped(path):
        from kreisel.formats.mapped import reader_of_imus

        return reader_of_imus(path)
    form = format_of(path)
    if form is None:
        raise RecordingError("is no recording with IMUs; give a folder, an .mcap file or a bag", file=path)
    return form.unit_reader(path)


def _mapped(path: Path) -> tuple[str, ...]:
    """Return the names of the IMUs that [columns] names; none for a file that needs no mapping, whatever is beside."""
    from kreisel.formats.mapped import imus_of  # here: most recordings need no tables of another shape

    return imus_of(path) if path.is_dir() or format_of(path) is None else ()

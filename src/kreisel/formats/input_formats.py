"""The forms of recordings that are read, by name. A further one is an entry here, and the module that reads it.

Tables whose columns need a mapping are no form of their own: `mapped` reads them, wherever they lie.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kreisel.formats.folder import imus_in as imus_in_folder
from kreisel.formats.folder import is_folder, load_folder, load_imu
from kreisel.recording.recording import DataWarning, ImuSamples, Recording
from kreisel.tasks import Executor

ImuReadings = tuple[ImuSamples, tuple[DataWarning, ...]]
ReadImu = Callable[[str], ImuReadings]


@dataclass(frozen=True)
class InputFormat:
    """A form of recordings.

    Attributes
    ----------
    suffixes
        Of the files that are recordings by themselves.
    recognises
        Whether a path is such a recording, by its name and the names in it.
    read
        Returns the recording at a path, with the names of reference and IMU if they are given.
    readings
        Returns those of the IMU alone, by its name if one is given; None for folders, whose table is read in blocks.
    units
        Returns the names of the IMUs that are units of one tray; all IMUs if the second argument is true.
    unit_reader
        Returns what reads one unit by its name.
    is_copied
        Whether `apply` makes a copy with a further topic; otherwise it writes a table.
    """

    suffixes: tuple[str, ...]
    recognises: Callable[[Path], bool]
    read: Callable[[Path, str | None, str | None, Executor], Recording]
    readings: Callable[[Path, str | None], ImuReadings] | None
    units: Callable[[Path, bool], tuple[str, ...]]
    unit_reader: Callable[[Path], ReadImu]
    is_copied: bool = False


def format_of(path: Path) -> InputFormat | None:
    """Return the form of the recording at a path; None if there is none of those in `FORMATS`."""
    return next((one for one in FORMATS.values() if one.recognises(path)), None)


def _read_folder(path: Path, reference: str | None, imu: str | None, executor: Executor) -> Recording:
    return load_folder(path, reference, imu or "imu0", executor)


def is_bag(path: Path) -> bool:
    """Return whether it is a bag; so is a folder that a stopped recorder left without metadata.yaml.

    Several .mcap files are parts of one bag if their names differ by the number at their end only.
    """
    if path.is_dir():
        names = {re.sub(r"_\d+$", "", file.stem) for file in path.glob("*.mcap")}
        return (path / "metadata.yaml").is_file() or len(names) == 1
    return path.suffix.lower() in FORMATS["bag"].suffixes


def _read_bag(path: Path, reference: str | None, imu: str | None, executor: Executor) -> Recording:
    from kreisel.formats.bag import load_bag  # here, because rosbags is slow to import

    del executor
    return load_bag(path, reference, imu)


def _readings_of_bag(path: Path, imu: str | None) -> ImuReadings:
    from kreisel.formats.bag_copy import imu_messages

    messages = imu_messages(path, imu)
    return messages.samples, messages.warnings


def _units_of_folder(path: Path, everything: bool) -> tuple[str, ...]:
    del everything
    return imus_in_folder(path)


def _reader_of_folder(path: Path) -> ReadImu:
    return partial(load_imu, path)


def _units_of_bag(path: Path, everything: bool) -> tuple[str, ...]:
    from kreisel.formats.bag import topics_in
    from kreisel.formats.bag_topics import unit_topics

    return tuple(unit_topics(topics_in(path), everything=everything))


def _reader_of_bag(path: Path) -> ReadImu:
    from kreisel.formats.bag_units import BagUnits

    return BagUnits(path)


FORMATS = {
    "folder": InputFormat((), is_folder, _read_folder, None, _units_of_folder, _reader_of_folder),
    "bag": InputFormat(
        (".mcap", ".bag", ".db3"), is_bag, _read_bag, _readings_of_bag, _units_of_bag, _reader_of_bag, is_copied=True
    ),
}

SUFFIXES = tuple(suffix for one in FORMATS.values() for suffix in one.suffixes)
"""Of all files that are recordings by themselves."""


def names_of_files() -> str:
    """Return the suffixes for a message: ".mcap, .bag or .db3"."""
    return f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"

"""Readings of several IMUs in one bag, some units in each pass, for all their messages may not have room in memory."""

from __future__ import annotations

from pathlib import Path

from kreisel.errors import RecordingError
from kreisel.formats.bag import body_of, imu_of, on_one_line, read_contents, topics_in
from kreisel.formats.bag_messages import decode_topic
from kreisel.formats.bag_topics import IMU_ROLE, unit_topics
from kreisel.formats.mcap import NO_LIMIT, Contents, Only
from kreisel.formats.topic_names import IMU
from kreisel.recording.recording import DataWarning, ImuSamples

TOGETHER = 1_000_000
"""Messages of IMUs that are read in one pass. Chosen: 0.5 GB; ten minutes of eight units at 200 Hz."""

Readings = tuple[ImuSamples, tuple[DataWarning, ...]]


class BagUnits:
    """Reads the units of a bag by their names, one at a time.

    Readings of units that are asked for later are kept from a pass until they are taken, once.

    Parameters
    ----------
    path
        As for `load_bag`.
    """

    def __init__(self, path: Path) -> None:
        topics = topics_in(path)
        self._path, self._units = path, unit_topics(topics, everything=True)
        self._sizes = {name: sum(t.count for t in topics if t.name == topic) for name, topic in self._units.items()}
        self._waiting: dict[str, Readings | RecordingError] = {}
        self._taken: set[str] = set()

    def __call__(self, name: str) -> Readings:
        """Return a unit's readings, as they were recorded, and what was found in them.

        Raises
        ------
        RecordingError
            If there is no such unit, or it cannot be read.
        """
        if name not in self._waiting:
            self._read(self._group(name))
        found = self._waiting.pop(name)
        self._taken.add(name)
        if isinstance(found, RecordingError):
            raise found
        return found

    def _group(self, name: str) -> list[str]:
        """Return which units are read together with one: those after it that were not read yet."""
        if name in self._taken or name not in self._units:
            return [name]
        names, room = [name], TOGETHER - self._sizes[name]
        order = list(self._units)
        for other in order[order.index(name) + 1 :]:
            room -= self._sizes[other]
            if room < 0 or other in self._taken or other in self._waiting:
                break
            names.append(other)
        return names

    def _read(self, names: list[str]) -> None:
        only: Only = {IMU: {self._units[name] for name in names if name in self._units}} if self._units else NO_LIMIT
        with on_one_line():
            contents = read_contents(self._path, only)
        for name in names:
            try:
                self._waiting[name] = _readings(contents, name)
            except RecordingError as error:
                self._waiting[name] = error


def _readings(contents: Contents, name: str) -> Readings:
    warnings = list(contents.warnings)
    with on_one_line():
        return imu_of(body_of(contents, IMU_ROLE, name, warnings, decode_topic), contents), tuple(warnings)

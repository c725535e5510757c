"""Reading a recording while it is being made; reader and recorder share the file only.

Of several IMUs the first is read.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from sys import intern

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.bag import notes_of, recording_of
from kreisel.formats.bag_messages import WANTED, Decoded, decode_topic
from kreisel.formats.mcap import RECORDED, Contents, McapScan, Topic, check_magic
from kreisel.formats.topic_names import IMU_TOPIC, NOTE_TYPE, is_of_a_further_unit
from kreisel.recording.recording import Recording
from kreisel.validation.checks import check_streams

MOST_READINGS = 300_000
"""Readings of an IMU that a bounded tail keeps. Chosen: ten minutes at `MOST_RATE`; 120 MB when calibrated."""

MOST_RATE = 500.0
"""Rate, 1/s, above which a bounded tail keeps means of readings. Chosen: an arm turns by 1 mrad in 2 ms at 30 deg/s."""

_MAGIC = 8  # bytes; length of the magic at the beginning of a file, by the MCAP specification


@dataclass
class Rows:
    """The messages of one topic: stamps, keys that distinguish bodies, and rows of numbers as in `formats.bag`."""

    topic: Topic
    width: int
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    keys: list[str] = field(default_factory=list)
    numbers: array[float] = field(default_factory=lambda: array("d"))

    def add(self, other: Rows, file: Path) -> None:
        """Add later messages.

        Raises
        ------
        RecordingError
            If their rows have another width.
        """
        if other.width != self.width:
            raise RecordingError(
                f"{self.topic.name} changes from {self.width} numbers to {other.width}; record one robot alone",
                file=file,
            )
        self.stamps_ns.extend(other.stamps_ns)
        self.keys.extend(other.keys)
        self.numbers.extend(other.numbers)

    def row(self, k: int) -> list[float]:
        """Return one row; the last is -1."""
        k %= len(self.stamps_ns)
        return self.numbers[k * self.width : (k + 1) * self.width].tolist()


class _Means:
    """Means of groups of readings, at a rate of `MOST_RATE` at most; a group ends where readings are missing.

    Attributes
    ----------
    group
        Readings in a mean; 0 before the rate is known.
    """

    _ENOUGH = 100  # readings that show the rate

    def __init__(self) -> None:
        self.group = 0
        self._step_ns = 0.0
        self._waiting: Rows | None = None

    def of(self, rows: Rows) -> Rows:
        """Return the means that are now complete."""
        waiting = self._waiting or Rows(rows.topic, rows.width)
        waiting.stamps_ns.extend(rows.stamps_ns)
        waiting.keys.extend(rows.keys)
        waiting.numbers.extend(rows.numbers)
        stamps = np.array(waiting.stamps_ns)
        if not self.group:
            self._waiting = waiting
            if stamps.size < self._ENOUGH:
                return Rows(rows.topic, rows.width)
            self._step_ns = float(np.median(np.diff(stamps)))
            self.group = max(1, int(1e9 / MOST_RATE / self._step_ns + 0.5))
        numbers = np.array(waiting.numbers).reshape(-1, rows.width)
        starts = np.flatnonzero(np.diff(stamps, prepend=stamps[0]) > 1.5 * self._step_ns)
        out, rest = Rows(rows.topic, rows.width), Rows(rows.topic, rows.width)
        for begin, end in pairwise([0, *starts.tolist(), stamps.size]):
            count = (end - begin) // self.group
            whole = slice(begin, begin + count * self.group)
            first = stamps[whole.start]
            offsets = (stamps[whole] - first).reshape(count, self.group).mean(axis=1)
            out.stamps_ns.extend((first + np.round(offsets)).astype(np.int64).tolist())
            out.keys.extend(waiting.keys[whole][:: self.group])
            out.numbers.extend(numbers[whole].reshape(count, self.group, rows.width).mean(axis=1).ravel().tolist())
            left = slice(whole.stop, end)
            if end == stamps.size:
                rest = Rows(
                    rows.topic, rows.width, waiting.stamps_ns[left], waiting.keys[left],
                    array("d", numbers[left].ravel().tolist()),
                )  # fmt: skip
        self._waiting = rest
        return out


class Tail:
    """The part of a recording that has been written so far.

    Parameters
    ----------
    path
        The .mcap file, or its folder.
    keep
        Whether `recording` will be called; otherwise only new messages are held, for the caller of `read`.
    bounded
        Whether what is kept is limited: means of the readings of fast IMUs, and nothing any more after
        `MOST_READINGS`.

    Attributes
    ----------
    full, whole
        Whether nothing more is kept; and whether all that has been read is, as it is.
    ended
        Whether the recorder has finished the file.
    notes
        Level and text of the recorder's notes.
    """

    def __init__(self, path: Path, *, keep: bool = True, bounded: bool = False) -> None:
        self.file = path if path.suffix == ".mcap" else path / RECORDED
        self.ended = False
        self.notes: list[tuple[int, str]] = []
        self._keep = keep
        self._scan = McapScan(WANTED)
        self._offset = 0
        self._identity: tuple[int, int] | None = None
        self._kept: dict[str, Rows] = {}
        self._means = _Means() if bounded else None
        self.full = False

    @property
    def begun(self) -> bool:
        """Whether anything has been read."""
        return self._offset > _MAGIC

    @property
    def whole(self) -> bool:
        """Whether all that has been read is kept, as it is."""
        return not self.full and (self._means is None or self._means.group <= 1)

    @property
    def urdf(self) -> str | None:
        """The robot's description."""
        return self._scan.urdf

    def read(self) -> Mapping[str, Rows]:
        """Read what has been written since the last call, and return it by topic.

        Raises
        ------
        RecordingError
            If the file does not exist, is not an MCAP file, was replaced, or contains a damaged message.
        """
        try:
            found = self.file.stat()
            size, identity = found.st_size, (found.st_dev, found.st_ino)
            if self._identity not in (None, identity):
                raise RecordingError("was replaced by another file while it was read; begin again", file=self.file)
            if size < self._offset:
                raise RecordingError(
                    f"became shorter while it was read ({size} bytes, {self._offset} were read): it was cut, or "
                    "written anew; begin again",
                    file=self.file,
                )
            self._identity = identity
            with self.file.open("rb") as stream:
                if self._offset == 0:
                    if size < _MAGIC:
                        return {}
                    check_magic(stream.read(_MAGIC), self.file)
                    self._offset = _MAGIC
                self._offset, goes_on = self._scan.follow(stream, self._offset, size)
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror}", file=self.file) from error
        self.ended = not goes_on
        new: dict[str, Rows] = {}
        for topic in self._scan.take_fresh():
            if topic.msgtype == NOTE_TYPE:
                self.notes += notes_of(Contents(self.file, (topic,)))
            elif topic.msgtype in WANTED and not is_of_a_further_unit(topic.name):
                new[topic.name] = self._rows(topic)
        if self._keep and not self.full:
            self._add(new)
        return new

    def _add(self, new: Mapping[str, Rows]) -> None:
        for name, rows in new.items():
            taken = rows if self._means is None or name != IMU_TOPIC else self._means.of(rows)
            if not taken.stamps_ns:
                continue  # of a topic without rows nothing could be made
            kept = self._kept.setdefault(name, Rows(rows.topic, rows.width))
            kept.add(taken, self.file)
            if self._means is not None and name == IMU_TOPIC:
                self.full = len(kept.stamps_ns) >= MOST_READINGS

    def recording(self) -> Recording:
        """Return the recording written so far, with the checks of a complete one.

        Raises
        ------
        RecordingError
            If it is still too short, or not usable.
        """
        topics = tuple(rows.topic for rows in self._kept.values())
        contents = Contents(self.file, topics, self._scan.settings, urdf=self._scan.urdf)
        return check_streams(recording_of(contents, decode=self._decoded))

    def _rows(self, topic: Topic) -> Rows:
        stamps, keys, rows = decode_topic(topic, self.file)
        numbers = array("d")
        for row in rows:
            numbers.extend(row)
        width = len(rows[0])
        if len(numbers) != width * len(rows):
            raise RecordingError(f"messages on {topic.name} differ in length; record one robot alone", file=self.file)
        return Rows(topic, width, array("q", stamps.tolist()), [intern(key) for key in keys], numbers)

    def _decoded(self, topic: Topic, path: Path) -> Decoded:  # noqa: ARG002 - messages are decoded as they are read
        kept = self._kept[topic.name]
        numbers = np.array(kept.numbers).reshape(-1, kept.width)
        return np.array(kept.stamps_ns), kept.keys, numbers

"""Reading a recording while it is being made; reader and recorder share the file only."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.formats.bag import WANTED, Decoded, decode_topic, notes_of, recording_of
from kreisel.formats.mcap import NOTE_TYPE, RECORDED, Contents, McapScan, Topic, check_magic
from kreisel.recording.recording import Recording
from kreisel.validation.checks import check_streams

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


class Tail:
    """The part of a recording that has been written so far.

    Parameters
    ----------
    path
        The .mcap file, or its folder.
    keep
        Whether `recording` will be called; otherwise only new messages are held, for the caller of `read`.

    Attributes
    ----------
    ended
        Whether the recorder has finished the file.
    notes
        Level and text of the recorder's notes.
    """

    def __init__(self, path: Path, *, keep: bool = True) -> None:
        self.file = path if path.suffix == ".mcap" else path / RECORDED
        self.ended = False
        self.notes: list[tuple[int, str]] = []
        self._keep = keep
        self._scan = McapScan(WANTED)
        self._offset = 0
        self._kept: dict[str, Rows] = {}

    @property
    def begun(self) -> bool:
        """Whether anything has been read."""
        return self._offset > _MAGIC

    @property
    def urdf(self) -> str | None:
        """The robot's description."""
        return self._scan.urdf

    def read(self) -> Mapping[str, Rows]:
        """Read what has been written since the last call, and return it by topic.

        Raises
        ------
        RecordingError
            If the file does not exist, is not an MCAP file, or contains a damaged message.
        """
        try:
            size = self.file.stat().st_size
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
            elif topic.msgtype in WANTED:
                new[topic.name] = self._rows(topic)
        if self._keep:
            for name, rows in new.items():
                self._kept.setdefault(name, Rows(rows.topic, rows.width)).add(rows, self.file)
        return new

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
        return Rows(topic, width, array("q", stamps.tolist()), keys, numbers)

    def _decoded(self, topic: Topic, path: Path) -> Decoded:  # noqa: ARG002 - messages are decoded as they are read
        kept = self._kept[topic.name]
        numbers = np.array(kept.numbers).reshape(-1, kept.width)
        return np.array(kept.stamps_ns), kept.keys, numbers

"""A recording that is still being made, read as it grows; the file is all that ties reader and recorder together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.errors import RecordingError
from kreisel.recording import Recording
from kreisel.recording.bag import WANTED, Decoded, decode_topic, notes_of, recording_of
from kreisel.recording.checks import check_streams
from kreisel.recording.mcap import NOTE_TYPE, RECORDED, Contents, McapScan, Topic, check_magic

_MAGIC = 8


class Tail:
    """What there is of a recording by now.

    Parameters
    ----------
    path
        The .mcap file, or the folder it is made in.

    Attributes
    ----------
    ended
        Whether its recorder has finished it.
    """

    def __init__(self, path: Path) -> None:
        self.file = path if path.suffix == ".mcap" else path / RECORDED
        self.ended = False
        self._scan = McapScan(WANTED)
        self._offset = 0
        self._decoded: dict[str, Decoded] = {}

    def read(self) -> None:
        """Take what has been written since.

        Raises
        ------
        RecordingError
            If there is no such file, or it is not an MCAP file.
        """
        try:
            size = self.file.stat().st_size
            with self.file.open("rb") as stream:
                if self._offset == 0:
                    if size < _MAGIC:
                        return
                    check_magic(stream.read(_MAGIC), self.file)
                    self._offset = _MAGIC
                self._offset, goes_on = self._scan.follow(stream, self._offset, size)
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror}", file=self.file) from error
        self.ended = not goes_on

    @property
    def begun(self) -> bool:
        """Whether there is anything yet."""
        return self._offset > _MAGIC

    def topics(self) -> dict[str, Decoded]:
        """Return stamps, keys and rows of every topic of readings or poses, by its name."""
        numbers = [topic for topic in self._scan.topics() if topic.msgtype in WANTED - {NOTE_TYPE}]
        return {topic.name: self._decode(topic, self.file) for topic in numbers}

    def notes(self) -> list[tuple[int, str]]:
        """Return level and text of what the recorder noted."""
        return notes_of(self._contents())

    @property
    def urdf(self) -> str | None:
        """The robot's description."""
        return self._scan.urdf

    def recording(self) -> Recording:
        """Return the recording as far as it goes, checked like a whole one.

        Raises
        ------
        RecordingError
            If it is too short yet, or of no use.
        """
        return check_streams(recording_of(self._contents(), decode=self._decode))

    def _contents(self) -> Contents:
        return Contents(self.file, tuple(self._scan.topics()), self._scan.settings, (), self._scan.urdf)

    def _decode(self, topic: Topic, path: Path) -> Decoded:
        """Decode what is new of a topic, and put it behind what was."""
        stamps, keys, rows = self._decoded.get(topic.name, (np.zeros(0, dtype=np.int64), [], []))
        if len(topic.payloads) > len(rows):
            new = decode_topic(replace(topic, payloads=topic.payloads[len(rows) :]), path)
            keys += new[1]
            rows += new[2]
            self._decoded[topic.name] = (np.concatenate([stamps, new[0]]), keys, rows)
        return self._decoded.get(topic.name, (stamps, keys, rows))

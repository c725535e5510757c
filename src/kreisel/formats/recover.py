"""Recovery of a truncated or damaged recording: its undamaged contents are written to a new file."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from kreisel._version import __version__
from kreisel.errors import RecordingError
from kreisel.formats.budget import Budget
from kreisel.formats.mcap import (
    CHUNK_SIZE,
    NO_FOOTER,
    RECORD_HEAD,
    BrokenRecordError,
    McapScan,
    check_magic,
    cut_text,
    record_stream,
    records_of,
    summary_start,
)

_KINDS = tuple(struct.pack("<I", len(name)) + name for name in (b"zstd", b"lz4"))
"""Name of a chunk's compression, as it lies in a chunk."""

_BEFORE_KIND = RECORD_HEAD.size + 28
"""Bytes of a chunk before it: the head, two times, a size and a checksum."""

_PART = 1 << 20
"""Bytes that are searched at once."""


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: messages by topic, their duration on the host's clock, and the text of what was lost."""

    path: Path
    messages: dict[str, int]
    seconds: float
    lost: str


def recover(path: Path, output: Path | None = None) -> Recovery:
    """Write the undamaged contents of an MCAP file to a readable copy next to it.

    Raises
    ------
    RecordingError
        If it is not an MCAP file, cannot be read, or the copy cannot be written.
    """
    output = output or path.with_name(f"{path.stem}_recovered.mcap")
    if output.exists():
        raise RecordingError("exists already; delete it, or name another with -o", file=output)
    try:
        size = path.stat().st_size
        with path.open("rb") as source:
            check_magic(source.read(8), path)
            try:
                with output.open("xb") as target:
                    copy = _Copy(target)
                    copy.read(source, size)
                    copy.finish()
            except BaseException:
                with suppress(OSError):
                    output.unlink()
                raise
    except OSError as error:
        raise RecordingError(f"cannot be copied: {error.strerror}", file=error.filename or path) from error
    return Recovery(output, dict(copy.messages), copy.seconds, copy.lost())


class _Copy(McapScan):
    """A pass through a file that copies the undamaged contents."""

    def __init__(self, target: BinaryIO) -> None:
        super().__init__(frozenset())
        self.messages: dict[str, int] = defaultdict(int)
        self._first: int | None = None
        self._last = 0
        self._writer = Writer(target, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"kreisel {__version__}")
        self._numbers: dict[int, int] = {}
        self._metadata: set[str] = set()

    @property
    def seconds(self) -> float:
        """Duration of the messages on the host's clock, s."""
        return 0.0 if self._first is None else (self._last - self._first) * 1e-9

    def read(self, stream: BinaryIO, size: int) -> None:
        """Copy all records; where the file is damaged, from the next chunk on.

        The definitions of the summary come first: the chunk that holds them may be damaged.
        """
        begin = stream.tell()
        self._budget = Budget(2 * size)
        start = summary_start(stream, size)
        if start is not None:
            with suppress(BrokenRecordError):
                stream.seek(start)
                for offset, opcode, content in records_of(stream, size):
                    if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                        self._try(offset, opcode, content)
        self._lost.clear()
        following: int | None = begin
        while following is not None:
            following = self._read_from(stream, following, size)

    def _read_from(self, stream: BinaryIO, begin: int, size: int) -> int | None:
        """Copy the records from an offset on; return the offset at which to go on after damage."""
        stream.seek(begin)
        try:
            for offset, opcode, content in records_of(stream, size):
                if opcode == Opcode.FOOTER:
                    return None
                faults = len(self._lost)
                self._try(offset, opcode, content)
                damaged = len(self._lost) > faults and opcode == Opcode.CHUNK
                if damaged and not _is_record(stream, offset + RECORD_HEAD.size + len(content), size):
                    return _next_chunk(stream, offset + RECORD_HEAD.size, size)
        except BrokenRecordError as broken:
            following = _next_chunk(stream, broken.offset + 1, size)
            if following is None:
                self._lost.append(cut_text(broken, size))
            else:
                span = f"{following - broken.offset} bytes from byte {broken.offset} on"
                self._lost.append(f"it is damaged: {span} are lost")
            return following
        self._lost.append(NO_FOOTER)
        return None

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _take(self, opcode: int, content: bytes) -> None:
        super()._take(opcode, content)
        if opcode == Opcode.METADATA:
            record = Metadata.read(record_stream(content))
            if record.name not in self._metadata:
                self._metadata.add(record.name)
                self._writer.add_metadata(record.name, record.metadata)

    def _take_message(self, content: bytes) -> None:
        super()._take_message(content)
        message = Message.read(record_stream(content), len(content))
        channel = self._channels.get(message.channel_id)
        if channel is None:
            return
        if message.channel_id not in self._numbers:
            self._numbers[message.channel_id] = self._register(channel)
        number = self._numbers[message.channel_id]
        self._writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)
        self.messages[channel.topic] += 1
        self._first = message.log_time if self._first is None else min(self._first, message.log_time)
        self._last = max(self._last, message.log_time)

    def _register(self, channel: Channel) -> int:
        schema: Schema | None = self._schemas.get(channel.schema_id)
        number = 0 if schema is None else self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return self._writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata)


def _is_record(stream: BinaryIO, offset: int, size: int) -> bool:
    """Return whether a record that the format knows may begin at an offset."""
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return False
    opcode, length = RECORD_HEAD.unpack(head)
    return opcode in set(Opcode) and offset + RECORD_HEAD.size + length <= size


def _next_chunk(stream: BinaryIO, begin: int, size: int) -> int | None:
    """Return the offset of the first compressed chunk from an offset on; None if there is none."""
    overlap = _BEFORE_KIND + max(map(len, _KINDS))
    for at in range(begin, size, _PART):
        stream.seek(at)
        part = stream.read(_PART + overlap)
        found = [offset for kind in _KINDS for offset in _chunks(part, kind)]
        fitting = sorted(offset for offset in found if _is_record(stream, at + offset, size))
        if fitting:
            return at + fitting[0]
    return None


def _chunks(part: bytes, kind: bytes) -> Iterator[int]:
    """Yield where chunks of a compression may begin."""
    found = part.find(kind)
    while found >= 0:
        if found >= _BEFORE_KIND and part[found - _BEFORE_KIND] == Opcode.CHUNK:
            yield found - _BEFORE_KIND
        found = part.find(kind, found + 1)

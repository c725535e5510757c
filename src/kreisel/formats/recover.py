"""Recovery of a truncated or damaged recording: its undamaged contents are written to a new file."""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from kreisel._version import __version__
from kreisel.errors import RecordingError
from kreisel.formats.mcap import CHUNK_SIZE, McapScan, check_magic, record_stream


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

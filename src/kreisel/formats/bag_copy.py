"""Bags and MCAP files copied as they are, with one more topic: the IMU's messages with other readings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType
from mcap.writer import Writer as McapFileWriter
from rosbags.interfaces import Connection, ConnectionExtRosbag2, TopicInfo
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from kreisel._version import __version__
from kreisel.errors import RecordingError, reason
from kreisel.formats.bag import body_of, imu_of, read_contents
from kreisel.formats.bag_messages import decode_topic
from kreisel.formats.bag_topics import IMU_ROLE
from kreisel.formats.mcap import CHUNK_SIZE, bounded_records, record_stream
from kreisel.formats.topic_names import IMU
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import DataWarning, ImuSamples

_STORES = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
_FORMAT: Literal[9] = 9
"""Version of the metadata of ROS 2 bags that are written; that of ROS 2 Iron and later."""


@dataclass(frozen=True)
class ImuMessages:
    """The messages of one IMU in a bag, in their order, and what they hold.

    Attributes
    ----------
    topic, encoding
        Name of the topic; `cdr` or `ros1`.
    payloads, log_times_ns
        As stored.
    samples
        Their readings.
    """

    topic: str
    encoding: str
    payloads: list[bytes]
    log_times_ns: list[int]
    samples: ImuSamples
    warnings: tuple[DataWarning, ...]

    def with_readings(self, rates: Array, accelerations: Array) -> list[tuple[int, bytes]]:
        """Return log times and messages with other angular rates and accelerations (n, 3) each."""
        store = get_typestore(_STORES[self.encoding])
        read = store.deserialize_cdr if self.encoding == "cdr" else store.deserialize_ros1
        written = store.serialize_cdr if self.encoding == "cdr" else store.serialize_ros1
        out = []
        for log_time, payload, w, a in zip(
            self.log_times_ns, self.payloads, rates.tolist(), accelerations.tolist(), strict=True
        ):
            message: Any = read(payload, IMU)
            for field, values in ((message.angular_velocity, w), (message.linear_acceleration, a)):
                field.x, field.y, field.z = values
            out.append((log_time, bytes(written(message, IMU))))
        return out


def imu_messages(path: Path, imu: str | None = None) -> ImuMessages:
    """Return the messages of the IMU in a bag or MCAP file; `imu` as for `load_bag`.

    Raises
    ------
    RecordingError
        If there are none, the choice is not clear, or the file cannot be read.
    """
    contents = read_contents(path)
    warnings = list(contents.warnings)
    body = body_of(contents, IMU_ROLE, imu, warnings, decode_topic)
    samples = imu_of(body, contents)
    assert body is not None  # noqa: S101 - `imu_of` has raised an error where there is none
    topic, kept = body.topic, np.flatnonzero(body.keep)
    return ImuMessages(
        topic.name,
        topic.encoding,
        [topic.payloads[k] for k in kept],
        [topic.log_times_ns[k] for k in kept],
        samples,
        tuple(warnings),
    )


def copy_with_topic(path: Path, out: Path, messages: ImuMessages, topic: str, added: list[tuple[int, bytes]]) -> None:
    """Write a copy of a bag with one more topic of the IMU's type; all else is copied byte for byte.

    Parameters
    ----------
    out
        An .mcap file for an .mcap file, a .bag file for one, otherwise the folder of a ROS 2 bag.
    topic, added
        Name of the new topic; log times and messages.

    Raises
    ------
    RecordingError
        If it cannot be read or written. What was written is deleted then.
    """
    copy: Callable[[Path, Path, ImuMessages, str, list[tuple[int, bytes]]], None] = (
        _copy_mcap if path.suffix.lower() == ".mcap" else _copy_bag1 if path.suffix.lower() == ".bag" else _copy_bag2
    )
    if topic == messages.topic:
        raise RecordingError(
            f"has a topic '{topic}' already, that of the raw readings; give another --topic", file=path
        )
    with _whole(out):
        copy(path, out, messages, topic, added)


@contextmanager
def _whole(out: Path) -> Iterator[None]:
    """Delete an incomplete copy, and turn errors of libraries into ours."""
    try:
        yield
    except BaseException as error:
        if out.is_file():
            out.unlink()
        elif out.is_dir():
            for file in out.iterdir():
                file.unlink()
            out.rmdir()
        if isinstance(error, RecordingError) or not isinstance(error, Exception):
            raise
        raise RecordingError(f"cannot be copied: {reason(error)}; `kreisel convert` may read it", file=out) from error


class _Merged:
    """Messages to be added, taken when their log time has come."""

    def __init__(self, added: list[tuple[int, bytes]]) -> None:
        self._added, self._next = added, 0

    def until(self, log_time: float) -> Iterator[tuple[int, bytes]]:
        while self._next < len(self._added) and self._added[self._next][0] <= log_time:
            yield self._added[self._next]
            self._next += 1


_READERS: dict[int, Callable[[bytes], Any]] = {
    Opcode.SCHEMA: lambda content: Schema.read(record_stream(content)),
    Opcode.CHANNEL: lambda content: Channel.read(record_stream(content)),
    Opcode.MESSAGE: lambda content: Message.read(record_stream(content), len(content)),
    Opcode.METADATA: lambda content: Metadata.read(record_stream(content)),
    Opcode.ATTACHMENT: lambda content: Attachment.read(record_stream(content)),
}


def _copy_mcap(path: Path, out: Path, messages: ImuMessages, topic: str, added: list[tuple[int, bytes]]) -> None:
    merged = _Merged(added)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    own: int | None = None
    with path.open("rb") as source, out.open("xb") as target:
        writer = McapFileWriter(target, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        writer.start(profile="ros2" if messages.encoding == "cdr" else "ros1", library=f"kreisel {__version__}")
        for opcode, content in bounded_records(source, path.stat().st_size):
            record = _READERS[opcode](content) if opcode in _READERS else None
            if isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                new = writer.register_channel, record.message_encoding, schemas[record.schema_id], record.metadata
                channels[record.id] = new[0](record.topic, *new[1:])
                if record.topic == topic:
                    raise RecordingError(f"has a topic '{topic}' already; give another --topic", file=path)
                if record.topic == messages.topic:
                    own = new[0](topic, *new[1:])
            elif isinstance(record, Message):
                for log_time, payload in merged.until(record.log_time) if own is not None else ():
                    writer.add_message(own, log_time, payload, log_time)  # type: ignore[arg-type]
                writer.add_message(
                    channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
                )
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        for log_time, payload in merged.until(np.inf) if own is not None else ():
            writer.add_message(own, log_time, payload, log_time)  # type: ignore[arg-type]
        writer.finish()  # type: ignore[no-untyped-call]


def _copy_bag1(path: Path, out: Path, messages: ImuMessages, topic: str, added: list[tuple[int, bytes]]) -> None:
    with Ros1Reader(path) as reader, Ros1Writer(out) as writer:

        def connected(connection: Connection, name: str) -> Connection:
            return writer.add_connection(
                name, connection.msgtype, msgdef=connection.msgdef.data, md5sum=connection.digest
            )

        _copy_all(reader, writer, connected, messages, topic, added, path)


def _copy_bag2(path: Path, out: Path, messages: ImuMessages, topic: str, added: list[tuple[int, bytes]]) -> None:
    mcap = path.is_dir() and any(path.glob("*.mcap*"))
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    store = get_typestore(_STORES["cdr"])
    with Ros2Reader(path) as reader, Ros2Writer(out, version=_FORMAT, storage_plugin=plugin) as writer:

        def connected(connection: Connection, name: str) -> Connection:
            known = connection.msgdef.data and connection.digest
            definition: dict[str, Any] = (
                {"msgdef": connection.msgdef.data, "rihs01": connection.digest} if known else {"typestore": store}
            )
            more = connection.ext
            if isinstance(more, ConnectionExtRosbag2):
                definition |= {
                    "serialization_format": more.serialization_format,
                    "offered_qos_profiles": more.offered_qos_profiles,
                }
            return writer.add_connection(name, connection.msgtype, **definition)

        _copy_all(reader, writer, connected, messages, topic, added, path)


def _copy_all(
    reader: Ros1Reader | Ros2Reader,
    writer: Ros1Writer | Ros2Writer,
    connected: Callable[[Connection, str], Connection],
    messages: ImuMessages,
    topic: str,
    added: list[tuple[int, bytes]],
    path: Path,
) -> None:
    topics: dict[str, TopicInfo] = reader.topics
    if topic in topics:
        raise RecordingError(f"has a topic '{topic}' already; give another --topic", file=path)
    merged = _Merged(added)
    copies = {connection.id: connected(connection, connection.topic) for connection in reader.connections}
    raw = next(connection for connection in reader.connections if connection.topic == messages.topic)
    own = connected(raw, topic)
    for connection, log_time, payload in reader.messages():
        for earlier, message in merged.until(log_time):
            writer.write(own, earlier, message)
        writer.write(copies[connection.id], log_time, payload)
    for later, message in merged.until(np.inf):
        writer.write(own, later, message)

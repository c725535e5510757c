"""MCAP files: kreisel's own recordings are written; files of any recorder are read, complete or truncated.

What is written is a ROS 2 file (CDR messages, `ros2msg` schemas, zstd chunks of 64 KiB) that Foxglove,
rosbags and the mcap tools open. It is read as a stream, never through its index, because the index is
at the end and is missing where a recorder was stopped.
"""

from __future__ import annotations

import operator
import struct
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from kreisel._version import __version__
from kreisel.errors import RecordingError, reason
from kreisel.formats.bounds import chunk_content, within
from kreisel.formats.budget import MAX_CHUNK, Budget
from kreisel.formats.topic_names import (
    JOINT_TOPIC,
    NOTE_TOPIC,
    NOTE_TYPE,
    ORIENTATION_TOPIC,
    POSE_TOPIC,
    POSITION_TOPIC,
    topic_of,
)
from kreisel.recording.recording import DataWarning
from kreisel.recording.recording_settings import RecordingSettings

INFO, WARN = 20, 30
"""Levels of notes."""

SETTINGS_RECORD = "kreisel/recording"
"""Name of the metadata record with the settings; its keys are `table.key` as in `recording.toml`."""

URDF_RECORD = "kreisel.robot"
"""Name of the metadata record with the robot's description, under the key `urdf`."""

RECORDED = "recording.mcap"
"""Name of the file in the folder of a recording that was made live."""

CHUNK_SIZE = 64 * 1024
"""Bytes in a chunk before compression; a recorder that is killed may lose as much."""

_NO_COVARIANCE = np.zeros(9)  # sensor_msgs/Imu: zeros mean that it is unknown
_NO_ORIENTATION = np.array([-1.0, *np.zeros(8)])  # sensor_msgs/Imu: -1 means that there is none
_NO_EFFORT = np.zeros(0)
_IDENTITY = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z; not used by readers, because there is no orientation

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode of a record and length of its content."""

NO_FOOTER = "it ends without a footer, as after a recorder was stopped; the end is missing"
"""What is said of such a file."""

_FOOTER = struct.Struct("<QQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_MOST_OF_A_DEFINITION = 1 << 22
"""Largest number of bytes of a record that defines something. Chosen: the description of an arm has a megabyte."""

_READ = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.STATISTICS}


class McapWriter:
    """Write IMU readings, reference poses and joint angles into an MCAP stream, in any order.

    Parameters
    ----------
    stream
        A binary stream open for writing; it stays open.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"kreisel {__version__}")
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = defaultdict(int)

    def add_settings(self, settings: RecordingSettings) -> None:
        """Write the settings that are set; call it first, so that a truncated file has them too."""
        tables = settings.tables
        pairs = {f"{name}.{key}": str(value) for name, table in tables.items() for key, value in table.items()}
        if pairs:
            self._writer.add_metadata(SETTINGS_RECORD, pairs)

    def add_urdf(self, text: str) -> None:
        """Write the robot's description; like the settings, before the messages."""
        self._writer.add_metadata(URDF_RECORD, {"urdf": text})

    def add_imu(
        self, stamp_ns: int, rate: Sequence[float], acceleration: Sequence[float], log_ns: int | None = None,
        epoch: int = 1, unit: int = 0,
    ) -> None:  # fmt: skip
        """Write angular rate (rad/s) and acceleration (m/s^2) as sensor_msgs/Imu without orientation.

        Parameters
        ----------
        stamp_ns, log_ns
            Time of the device, and time of the host at arrival; the same by default.
        epoch
            Number of the device's clock; after a restart of the clock a separate topic is used.
        unit
            Number of the device among several IMUs; each has a topic.
        """
        message = self._new(
            "sensor_msgs/msg/Imu",
            self._header(stamp_ns, f"imu{unit or ''}"),
            self._quaternion(_IDENTITY),
            _NO_ORIENTATION,
            self._vector(rate),
            _NO_COVARIANCE,
            self._vector(acceleration),
            _NO_COVARIANCE,
        )
        self._add(_of_epoch(topic_of(unit), epoch), stamp_ns, message, log_ns)

    def add_pose(
        self, stamp_ns: int, position: Sequence[float] | None, quaternion: Sequence[float] | None,
        log_ns: int | None = None, epoch: int = 1,
    ) -> None:  # fmt: skip
        """Write a pose as PoseStamped, or one part of it as PointStamped or QuaternionStamped; see `add_imu`."""
        header = self._header(stamp_ns, "reference")
        if position is not None and quaternion is not None:
            pose = self._new("geometry_msgs/msg/Pose", self._point(position), self._quaternion(quaternion))
            posed = self._new("geometry_msgs/msg/PoseStamped", header, pose)
            self._add(_of_epoch(POSE_TOPIC, epoch), stamp_ns, posed, log_ns)
        elif position is not None:
            point = self._new("geometry_msgs/msg/PointStamped", header, self._point(position))
            self._add(_of_epoch(POSITION_TOPIC, epoch), stamp_ns, point, log_ns)
        elif quaternion is not None:
            turn = self._new("geometry_msgs/msg/QuaternionStamped", header, self._quaternion(quaternion))
            self._add(_of_epoch(ORIENTATION_TOPIC, epoch), stamp_ns, turn, log_ns)

    def add_joints(self, stamp_ns: int, angles: Sequence[float], log_ns: int | None = None, epoch: int = 1) -> None:
        """Write joint angles (rad) as sensor_msgs/JointState with the names joint_1, joint_2, …; see `add_imu`."""
        names = [f"joint_{k}" for k in range(1, len(angles) + 1)]
        header = self._header(stamp_ns, "robot")
        message = self._new("sensor_msgs/msg/JointState", header, names, np.array(angles), _NO_EFFORT, _NO_EFFORT)
        self._add(_of_epoch(JOINT_TOPIC, epoch), stamp_ns, message, log_ns)

    def add_note(self, stamp_ns: int, level: int, source: str, text: str) -> None:
        """Write an event as rcl_interfaces/Log, on the host's clock."""
        stamp = self._new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        self._add(NOTE_TOPIC, stamp_ns, self._new(NOTE_TYPE, stamp, level, source, text, "", "", 0))

    def flush(self) -> None:
        """Write the chunk that is being filled to the file, so that a stop loses nothing added before."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the index and the footer; nothing can be added afterwards."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _new(self, msgtype: str, *fields: object) -> Any:
        return self._store.types[msgtype](*fields)  # type: ignore[arg-type]

    def _header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self._new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return self._new("std_msgs/msg/Header", stamp, frame)

    def _vector(self, v: Sequence[float]) -> Any:
        return self._new("geometry_msgs/msg/Vector3", *v)

    def _point(self, p: Sequence[float]) -> Any:
        return self._new("geometry_msgs/msg/Point", *p)

    def _quaternion(self, q: Sequence[float]) -> Any:
        w, x, y, z = q
        return self._new("geometry_msgs/msg/Quaternion", x, y, z, w)

    def _add(self, topic: str, stamp_ns: int, message: Any, log_ns: int | None = None) -> None:
        msgtype = message.__msgtype__
        if topic not in self._channels:
            text, _ = self._store.generate_msgdef(msgtype, ros_version=2)
            schema = self._writer.register_schema(msgtype, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        data = bytes(self._store.serialize_cdr(message, msgtype, little_endian=True))
        log = stamp_ns if log_ns is None else log_ns
        self._writer.add_message(self._channels[topic], log, data, stamp_ns, self._counts[topic])
        self._counts[topic] += 1


def _of_epoch(topic: str, epoch: int) -> str:
    return topic if epoch == 1 else f"{topic}_{epoch}"


@dataclass(frozen=True)
class Topic:
    """The messages of one topic, as stored, in the order of their log times.

    Attributes
    ----------
    msgtype
        Such as `sensor_msgs/msg/Imu`, for ROS 1 too.
    encoding
        `cdr` or `ros1`; topics of other encodings are listed, never decoded.
    count
        Messages in the file; `payloads` is empty where they were not wanted.
    """

    name: str
    msgtype: str
    encoding: str
    count: int
    log_times_ns: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)


def in_log_order(name: str, msgtype: str, encoding: str, count: int, messages: Iterable[tuple[int, bytes]]) -> Topic:
    """Return a topic from pairs of log time and payload, sorted by the times."""
    ordered = sorted(messages, key=operator.itemgetter(0))
    return Topic(name, msgtype, encoding, count, [m[0] for m in ordered], [m[1] for m in ordered])


@dataclass(frozen=True)
class Contents:
    """Contents of a bag: topics, settings as `table.key` -> text, warnings, the robot's description.

    Attributes
    ----------
    begun_ns
        The earliest log time of all messages; None where it is not known.
    """

    path: Path
    topics: tuple[Topic, ...]
    settings: dict[str, str] = field(default_factory=dict)
    warnings: tuple[DataWarning, ...] = ()
    urdf: str | None = None
    begun_ns: int | None = None


Only = Mapping[str, Collection[str]]
"""Topics whose messages are kept, by message types; of a type that is not in it those on all topics are."""

NO_LIMIT: Only = {}
"""All topics."""


def read_mcap(path: Path, wanted: Collection[str], only: Only = NO_LIMIT) -> Contents:
    """Return the undamaged contents of an MCAP file, from its beginning to its end or to where it breaks.

    Parameters
    ----------
    wanted
        Message types whose payloads are kept.
    only
        The topics of a type whose payloads are kept; without an entry all.

    Raises
    ------
    RecordingError
        If it is not an MCAP file or cannot be opened. A truncated or damaged one gives a warning that says where
        it breaks and what is lost.
    """
    scan = McapScan(frozenset(wanted), only)
    try:
        with path.open("rb") as file:
            check_magic(file.read(len(MCAP0_MAGIC)), path)
            scan.read(file, path.stat().st_size)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=path) from error
    lost = scan.lost()
    warnings = (DataWarning(path.name, lost),) if lost else ()
    return Contents(path, tuple(scan.topics()), scan.settings, warnings, scan.urdf, scan.begun_ns)


def check_magic(start: bytes, path: Path) -> None:
    """Raise an error unless a file starts as MCAP files do."""
    if not start:
        raise RecordingError("is empty; expected an MCAP file", file=path)
    if start != MCAP0_MAGIC:
        raise RecordingError(
            f"is not an MCAP file: starts with {start.hex(' ')}, expected {MCAP0_MAGIC.hex(' ')}; "
            "check that it was copied completely and that its name is right",
            file=path,
        )


class BrokenRecordError(Exception):
    """A record that goes beyond the end of the file or chunk that holds it."""

    def __init__(self, offset: int, opcode: int, beginning: bytes) -> None:
        self.offset, self.opcode, self.beginning = offset, opcode, beginning
        super().__init__(f"broken record at byte {offset}")


def records_of(stream: BinaryIO, size: int, read: Collection[int] = _READ) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and content of the records; contents that are not used stay empty."""
    while (start := stream.tell()) < size:
        head = stream.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise BrokenRecordError(start, 0, b"")
        opcode, length = RECORD_HEAD.unpack(head)
        end = start + RECORD_HEAD.size + length
        # A zero is not an opcode; file systems leave zeros after a loss of power.
        if opcode == 0 or end > size:
            raise BrokenRecordError(start, opcode, stream.read(16))
        if opcode in read:
            yield start, opcode, stream.read(min(length, MAX_CHUNK + 1))
        else:
            yield start, opcode, b""
        stream.seek(end)


class McapScan:
    """One pass through a file: the contents found so far, and what was lost."""

    def __init__(self, wanted: frozenset[str], only: Only = NO_LIMIT) -> None:
        self.settings: dict[str, str] = {}
        self.urdf: str | None = None
        self.begun_ns: int | None = None
        self._wanted, self._only = wanted, only
        self._kept = wanted | {None}  # messages of a type that is not known yet may be wanted
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._messages: dict[int, list[tuple[int, bytes]]] = defaultdict(list)
        self._counts: dict[int, int] = defaultdict(int)
        self._announced: int | None = None
        self._lost: list[str] = []
        self._budget = Budget(0)

    def read(self, stream: BinaryIO, size: int) -> None:
        """Read all records up to the footer, or to where the file breaks."""
        self._budget = Budget(size)
        try:
            for offset, opcode, content in records_of(stream, size):
                if opcode == Opcode.FOOTER:
                    return
                self._try(offset, opcode, content)
        except BrokenRecordError as broken:
            self._lost.append(f"{cut_text(broken, size)}, unless `kreisel recover` finds more in them")
        else:
            self._lost.append(NO_FOOTER)

    def _define(self, content: bytes) -> None:
        """Count a record that defines something: what is kept of it, a few bytes of a chunk can stand for."""
        self._budget.take(len(within(content, _MOST_OF_A_DEFINITION)))

    def follow(self, stream: BinaryIO, offset: int, size: int) -> tuple[int, bool]:
        """Read the complete records from an offset on; return the offset of the next, and whether more can follow.

        This is for a file that is still being written.
        """
        self._budget = Budget(size - offset)
        stream.seek(offset)
        try:
            for start, opcode, content in records_of(stream, size):
                if opcode == Opcode.FOOTER:
                    return start, False
                self._try(start, opcode, content)
        except BrokenRecordError as broken:
            return broken.offset, True
        return size, True

    def _try(self, offset: int, opcode: int, content: bytes) -> None:
        """Read a record, or note that it is damaged: the library may raise any exception for damaged data."""
        try:
            if opcode == Opcode.CHUNK:
                self._take_chunk(within(content))
            else:
                self._take(opcode, within(content))
        except Exception as error:
            name = Opcode(opcode).name.lower()
            span = _span(content[:16]) if opcode == Opcode.CHUNK else ""
            self._lost.append(f"the {name} at byte {offset} is damaged{span} ({reason(error)})")

    def _take_chunk(self, content: bytes) -> None:
        chunk = Chunk.read(record_stream(content))
        data = chunk_content(chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc)
        for _, opcode, inner in records_of(BytesIO(data), len(data)):
            self._take(opcode, inner)

    def _take(self, opcode: int, content: bytes) -> None:
        if opcode in _DEFINITIONS:
            self._define(content)
        if opcode == Opcode.MESSAGE:
            self._take_message(content)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(record_stream(content))
            self._schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(record_stream(content))
            self._channels.setdefault(channel.id, channel)
        elif opcode == Opcode.STATISTICS:
            self._announced = Statistics.read(record_stream(content)).message_count
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(record_stream(content))
            if metadata.name == SETTINGS_RECORD:
                self.settings.update(metadata.metadata)
            elif metadata.name == URDF_RECORD:
                self.urdf = metadata.metadata.get("urdf")

    def _take_message(self, content: bytes) -> None:
        channel, _, log_time, _ = _MESSAGE_HEAD.unpack_from(content)
        self._counts[channel] += 1
        if self.begun_ns is None or log_time < self.begun_ns:
            self.begun_ns = log_time
        if (kind := self._type(channel)) in self._kept and self._is_asked_for(channel, kind):
            self._budget.take(len(content))
            self._messages[channel].append((log_time, content[_MESSAGE_HEAD.size :]))

    def _is_asked_for(self, number: int, kind: str | None) -> bool:
        return kind is None or kind not in self._only or self._channels[number].topic in self._only[kind]

    def _type(self, number: int) -> str | None:
        """Return a channel's message type; None where its definition is not (or not yet) known.

        The definitions are repeated at the end of the file, in case the chunk that holds them is damaged.
        """
        channel = self._channels.get(number)
        if channel is None or channel.schema_id == 0:
            return None if channel is None else ""
        schema = self._schemas.get(channel.schema_id)
        return None if schema is None else normal_type(schema.name)

    def topics(self) -> Iterator[Topic]:
        """Yield the topics; channels of one name, type and encoding are one topic."""
        groups: dict[tuple[str, str, str], list[int]] = defaultdict(list)
        for number, channel in self._channels.items():
            groups[channel.topic, self._type(number) or "", channel.message_encoding].append(number)
        for (name, msgtype, encoding), numbers in groups.items():
            count = sum(self._counts[number] for number in numbers)
            asked = msgtype in self._wanted and name in self._only.get(msgtype, (name,))
            kept = [m for number in numbers for m in self._messages[number]] if asked else []
            yield in_log_order(name, msgtype, encoding, count, kept)

    def take_fresh(self) -> Iterator[Topic]:
        """Yield the topics with their messages since the last call, and remove these messages."""
        for number, messages in self._messages.items():
            channel = self._channels.get(number)
            if channel is None or not messages:
                continue
            yield in_log_order(
                channel.topic, self._type(number) or "", channel.message_encoding, self._counts[number], messages
            )
            messages.clear()

    def lost(self) -> str:
        """Return the sentence that says what is missing; empty where the file is complete."""
        lost = list(self._lost)
        orphans = sum(count for number, count in self._counts.items() if self._type(number) is None)
        if orphans:
            lost.append(f"the definition of {orphans} messages is missing, so they are too")
        found = sum(self._counts.values())
        if not lost and self._announced is not None and self._announced != found:
            lost.append(f"its statistics state {self._announced} messages, {found} were found")
        more = f"; and {len(lost) - 3} more faults" if len(lost) > 3 else ""
        return "; ".join(lost[:3]) + more


def stated_topics(path: Path) -> list[Topic] | None:
    """Return the topics of an MCAP file with their numbers of messages, without the messages.

    They are None where the file does not state them: it was cut, or its recorder writes no statistics.

    Raises
    ------
    OSError
        If it cannot be read.
    RecordingError
        If it is not an MCAP file.
    """
    scan = _Summary()
    with path.open("rb") as file:
        check_magic(file.read(len(MCAP0_MAGIC)), path)
        scan.read(file, path.stat().st_size)
    return scan.stated()


class _Summary(McapScan):
    """A pass over the records of a file that leaves its chunks out."""

    def __init__(self) -> None:
        super().__init__(frozenset())
        self._stated: dict[int, int] | None = None

    def stated(self) -> list[Topic] | None:
        """Return the topics, or None where they are not stated."""
        if self.lost() or self._stated is None or not self._stated.keys() <= self._channels.keys():
            return None
        self._counts = self._stated
        return list(self.topics())

    def lost(self) -> str:
        """Return what is damaged outside chunks; messages in them are not counted."""
        return "; ".join(self._lost)

    def _take_chunk(self, content: bytes) -> None:
        del content

    def _take(self, opcode: int, content: bytes) -> None:
        super()._take(opcode, content)
        if opcode == Opcode.STATISTICS:
            found = Statistics.read(record_stream(content))
            counts = dict(found.channel_message_counts)
            self._stated = counts if sum(counts.values()) == found.message_count else None


def normal_type(msgtype: str) -> str:
    """Return a message type in the form of ROS 2: sensor_msgs/Imu is sensor_msgs/msg/Imu."""
    package, _, name = msgtype.partition("/")
    return msgtype if "/" in name or not name else f"{package}/msg/{name}"


def bounded_records(stream: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of all records of a file, those in chunks too, up to its footer.

    Raises
    ------
    ValueError
        If a record is broken, damaged, or larger than real ones are.
    """
    check_magic(stream.read(len(MCAP0_MAGIC)), Path(getattr(stream, "name", "")))
    try:
        for _, opcode, content in records_of(stream, size, _READ | {Opcode.ATTACHMENT}):
            if opcode == Opcode.FOOTER:
                return
            if opcode == Opcode.CHUNK:
                chunk = Chunk.read(record_stream(within(content)))
                data = chunk_content(chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc)
                yield from ((inner, part) for _, inner, part in records_of(BytesIO(data), len(data)))
            else:
                yield opcode, within(content)
    except BrokenRecordError as broken:
        raise ValueError(cut_text(broken, size)) from broken


def record_stream(content: bytes) -> ReadDataStream:
    """Return the content of a record as the library reads it."""
    return ReadDataStream(BytesIO(content))


def cut_text(broken: BrokenRecordError, size: int) -> str:
    """Return the sentence for a file that cannot be read further."""
    span = _span(broken.beginning) if broken.opcode == Opcode.CHUNK else ""
    left = size - broken.offset
    return f"it is cut or damaged at byte {broken.offset} of {size}; the last {left} bytes are lost{span}"


def summary_start(stream: BinaryIO, size: int) -> int | None:
    """Return where the summary of a file begins, by its footer; None if it has none."""
    end = RECORD_HEAD.size + _FOOTER.size + len(MCAP0_MAGIC)
    if size < 2 * end:
        return None
    stream.seek(size - end)
    opcode, _ = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    start, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
    return start if opcode == Opcode.FOOTER and 0 < start < size - end else None


def _span(beginning: bytes) -> str:
    """Return a text with the duration of a chunk's messages, from the first 16 bytes of the chunk."""
    if len(beginning) < 16:
        return ""
    first, last = struct.unpack("<QQ", beginning[:16])
    return f", with {(last - first) * 1e-9:.3g} s of messages" if 0 <= last - first < 3600 * 10**9 else ""

"""Messages of ROS 2 as they are on the network: readings, joint angles, poses and frames in CDR, without ROS.

A message is a representation header of four bytes (CDR or CDR 2, and the order of bytes), then its fields in order,
each number aligned to its size from the end of that header on, at most to 8 bytes in CDR and 4 in CDR 2. A string is
its length with the closing zero, then its bytes; a sequence is its length, then its items. Source: Object Management
Group, "Extensible and Dynamic Topic Types for DDS" 1.3, section 7.4; the fields are those of `common_interfaces`.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from kreisel.errors import ProtocolError
from kreisel.protocols.samples import ImuSample, Quadruple, RobotSample, Triple, checked_stamp, finite

IMU, JOINTS, POSE, TRANSFORM, FRAMES = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/TransformStamped",
    "tf2_msgs/msg/TFMessage",
)
"""Types of messages that are understood."""

MOST = 1000
"""Largest number of items of a sequence that is accepted. Chosen: a humanoid has a hundred joints and frames."""

_NAME = "ROS 2"
_HEADERS = {b"\0\0": (">", 8), b"\0\1": ("<", 8), b"\0\6": (">", 4), b"\0\7": ("<", 4)}
_UNIT = 1e-3
"""Largest deviation of a quaternion's norm from 1. Chosen: single precision and rounding to four digits stay within."""

_UR = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Joints of a Universal Robots arm from the base on; its driver sends them in another order."""


@dataclass(frozen=True, slots=True)
class Joints:
    """Angles by the names of joints."""

    stamp_ns: int
    names: tuple[str, ...]
    angles: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Transform:
    """Pose of a frame in its parent."""

    stamp_ns: int
    parent: str
    child: str
    position: Triple
    quaternion: Quadruple


class _Reader:
    """Reads the fields of a message one after another."""

    def __init__(self, data: bytes) -> None:
        if data[:2] not in _HEADERS or len(data) < 4:
            raise ProtocolError(_NAME, f"a message in an unknown representation: {data[:4].hex()}")
        self._data, self._at = data, 4
        self._order, self._align = _HEADERS[data[:2]]

    def numbers(self, kind: str, count: int) -> tuple[float, ...]:
        size = struct.calcsize(f"={kind}")
        self._at += -(self._at - 4) % min(size, self._align)
        end = self._at + count * size
        if end > len(self._data):
            raise ProtocolError(_NAME, f"a message of {len(self._data)} bytes ends too early")
        values = struct.unpack_from(f"{self._order}{count}{kind}", self._data, self._at)
        self._at = end
        return values

    def count(self) -> int:
        (count,) = self.numbers("I", 1)
        if count > MOST:
            raise ProtocolError(_NAME, f"a sequence of {count} items, expected {MOST} at most")
        return int(count)

    def text(self) -> str:
        (length,) = self.numbers("I", 1)
        if length > len(self._data) - self._at:
            raise ProtocolError(_NAME, f"a text of {length} bytes in a message of {len(self._data)}")
        content = self._data[self._at : self._at + int(length)]
        self._at += int(length)
        return content.rstrip(b"\0").decode("utf-8", "replace")

    def header(self) -> tuple[int, str]:
        """Return stamp and frame."""
        (seconds,), (nanoseconds,) = self.numbers("i", 1), self.numbers("I", 1)
        return checked_stamp(int(seconds) * 10**9 + int(nanoseconds), _NAME), self.text()

    def triple(self, what: str) -> Triple:
        x, y, z = finite(self.numbers("d", 3), _NAME, what)
        return x, y, z

    def quaternion(self) -> Quadruple:
        """Return the quaternion with w first, normalised."""
        x, y, z, w = finite(self.numbers("d", 4), _NAME, "an attitude")
        norm = math.hypot(x, y, z, w)
        if abs(norm - 1.0) > _UNIT:
            raise ProtocolError(_NAME, f"the quaternion of an attitude has the norm {norm:.6g}, expected 1")
        return w / norm, x / norm, y / norm, z / norm


class _Writer:
    """Writes the fields of a message one after another, in CDR, little-endian."""

    def __init__(self) -> None:
        self.data = bytearray(b"\0\1\0\0")

    def numbers(self, kind: str, *values: float) -> _Writer:
        self.data += b"\0" * (-(len(self.data) - 4) % struct.calcsize(f"={kind}"))
        self.data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def text(self, text: str) -> _Writer:
        content = text.encode() + b"\0"
        self.numbers("I", len(content))
        self.data += content
        return self

    def header(self, stamp_ns: int, frame: str) -> _Writer:
        return self.numbers("I", *divmod(stamp_ns, 10**9)).text(frame)

    def pose(self, position: Triple, quaternion: Quadruple) -> _Writer:
        return self.numbers("d", *position, *quaternion[1:], quaternion[0])


def decode_imu(data: bytes) -> ImuSample:
    """Return the reading of a `sensor_msgs/Imu`.

    Raises
    ------
    ProtocolError
        If it is not such a message, or has impossible values, or says that it has no rates or no accelerations.
    """
    reader = _Reader(data)
    stamp_ns, _ = reader.header()
    reader.numbers("d", 4 + 9)  # attitude and its covariance
    rate, rate_covariance = reader.triple("a rate"), reader.numbers("d", 9)
    acceleration, covariance = reader.triple("an acceleration"), reader.numbers("d", 9)
    for what, first in (("rates", rate_covariance[0]), ("accelerations", covariance[0])):
        if first == -1.0:
            raise ProtocolError(_NAME, f"the messages have no {what}: their covariance begins with -1")
    return ImuSample(stamp_ns, rate, acceleration)


def encode_imu(reading: ImuSample) -> bytes:
    """Return the `sensor_msgs/Imu` of a reading, without an attitude."""
    writer = _Writer().header(reading.stamp_ns, "imu").numbers("d", 0.0, 0.0, 0.0, 1.0, -1.0, *(0.0,) * 8)
    for triple in (reading.rate, reading.acceleration):
        writer.numbers("d", *triple, *(0.0,) * 9)
    return bytes(writer.data)


def decode_joints(data: bytes) -> Joints:
    """Return the angles of a `sensor_msgs/JointState`.

    Raises
    ------
    ProtocolError
        If it is not such a message, has impossible values, or not one angle for each name.
    """
    reader = _Reader(data)
    stamp_ns, _ = reader.header()
    names = tuple(reader.text() for _ in range(reader.count()))
    angles = finite(reader.numbers("d", reader.count()), _NAME, "a joint angle")
    if len(names) != len(angles):
        raise ProtocolError(_NAME, f"{len(angles)} angles of {len(names)} joints")
    return Joints(stamp_ns, names, angles)


def encode_joints(joints: Joints) -> bytes:
    """Return the `sensor_msgs/JointState` of angles, without velocities and efforts."""
    writer = _Writer().header(joints.stamp_ns, "base_link").numbers("I", len(joints.names))
    for name in joints.names:
        writer.text(name)
    writer.numbers("I", len(joints.angles)).numbers("d", *joints.angles)
    return bytes(writer.numbers("I", 0).numbers("I", 0).data)


def as_published(stamp_ns: int, angles: Sequence[float]) -> Joints:
    """Return angles from the base on as the driver of an arm publishes them: in the order of the alphabet."""
    names = _UR if len(angles) == len(_UR) else [str(k) for k in range(len(angles))]
    joints = sorted(zip((f"{name}_joint" for name in names), angles, strict=True))
    return Joints(stamp_ns, tuple(name for name, _ in joints), tuple(angle for _, angle in joints))


def decode_pose(data: bytes) -> RobotSample:
    """Return the pose of a `geometry_msgs/PoseStamped`.

    Raises
    ------
    ProtocolError
        If it is not such a message, or has impossible values.
    """
    reader = _Reader(data)
    stamp_ns, _ = reader.header()
    return RobotSample(stamp_ns, reader.triple("a position"), reader.quaternion())


def encode_pose(sample: RobotSample) -> bytes:
    """Return the `geometry_msgs/PoseStamped` of a pose."""
    position, quaternion = sample.position or (math.nan,) * 3, sample.quaternion or (math.nan,) * 4
    return bytes(_Writer().header(sample.stamp_ns, "world").pose(position, quaternion).data)


def decode_transform(data: bytes) -> Transform:
    """Return the pose of a `geometry_msgs/TransformStamped`.

    Raises
    ------
    ProtocolError
        If it is not such a message, or has impossible values.
    """
    return _transform(_Reader(data))


def decode_frames(data: bytes) -> list[Transform]:
    """Return the poses of a `tf2_msgs/TFMessage`.

    Raises
    ------
    ProtocolError
        If it is not such a message, or has impossible values.
    """
    reader = _Reader(data)
    return [_transform(reader) for _ in range(reader.count())]


def _transform(reader: _Reader) -> Transform:
    stamp_ns, parent = reader.header()
    child = reader.text()
    return Transform(stamp_ns, _plain(parent), _plain(child), reader.triple("a position"), reader.quaternion())


def _plain(frame: str) -> str:
    return frame.removeprefix("/")


def encode_frames(transforms: Sequence[Transform]) -> bytes:
    """Return the `tf2_msgs/TFMessage` of poses."""
    writer = _Writer().numbers("I", len(transforms))
    for one in transforms:
        writer.header(one.stamp_ns, one.parent).text(one.child).pose(one.position, one.quaternion)
    return bytes(writer.data)


def encode_transform(transform: Transform) -> bytes:
    """Return the `geometry_msgs/TransformStamped` of a pose."""
    writer = _Writer().header(transform.stamp_ns, transform.parent).text(transform.child)
    return bytes(writer.pose(transform.position, transform.quaternion).data)


def from_base(names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the names of an arm's joints in their order from the base on, None if the names do not show it.

    They show it if they differ in one number alone, or are those of a Universal Robots arm.
    """
    for name in names:
        prefix, found, _ = name.partition(_UR[0])
        of_ur = [f"{prefix}{joint}_joint" for joint in _UR]
        if found and sorted(names) == sorted(of_ur):
            return tuple(of_ur)
    parts = [re.fullmatch(r"(.*?)(\d+)(\D*)", name) for name in names]
    if not names or any(part is None for part in parts):
        return None
    numbers = {int(part[2]): part[0] for part in parts if part is not None}
    alike = len({(part[1], part[3]) for part in parts if part is not None}) == 1
    if not alike or len(numbers) != len(names) or max(numbers) - min(numbers) != len(names) - 1:
        return None
    return tuple(numbers[number] for number in sorted(numbers))


class Chain:
    """The pose of a frame in another one, from messages with the frames between them.

    Parameters
    ----------
    base, tool
        Names of the frames.
    """

    def __init__(self, base: str, tool: str) -> None:
        self._base, self._tool = _plain(base), _plain(tool)
        self._frames: dict[str, Transform] = {}
        self._static: set[str] = set()

    def take(self, transforms: Sequence[Transform], *, static: bool = False) -> RobotSample | None:
        """Take the frames of a message; return the tool's pose if one of them moves it.

        Raises
        ------
        ProtocolError
            If there is no way from the tool's frame up to the base's, or its frames are of different times.
        """
        for one in transforms[:MOST]:
            if len(self._frames) < MOST or one.child in self._frames:
                self._frames[one.child] = one
            if static:
                self._static.add(one.child)
        if static:
            return None
        way = self._way()
        moved = [one for one in way if one.child not in self._static]
        if not {one.child for one in transforms} & {one.child for one in moved}:
            return None
        stamps = {one.stamp_ns for one in moved}
        if len(stamps) > 1:
            raise ProtocolError(
                _NAME,
                f"the frames between '{self._tool}' and '{self._base}' are of times that differ by "
                f"{(max(stamps) - min(stamps)) * 1e-6:.3g} ms; choose base and tool whose frames come together",
            )
        position, quaternion = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        for one in way:
            position = _sum(one.position, _turned(one.quaternion, position))
            quaternion = _product(one.quaternion, quaternion)
        return RobotSample(stamps.pop(), position, quaternion)

    def _way(self) -> list[Transform]:
        """Return the frames from the tool's up to the base's."""
        way: list[Transform] = []
        frame = self._tool
        while frame != self._base:
            step = self._frames.get(frame)
            if step is None or len(way) > len(self._frames):
                known = ", ".join(sorted(self._frames)[:20]) or "none"
                raise ProtocolError(
                    _NAME,
                    f"no frames lead from '{self._tool}' up to '{self._base}'; '{frame}' has no parent; frames "
                    f"that come are: {known}",
                )
            way.append(step)
            frame = step.parent
        return way


def _sum(a: Triple, b: Triple) -> Triple:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _product(p: Quadruple, q: Quadruple) -> Quadruple:
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


def _turned(q: Quadruple, v: Triple) -> Triple:
    _, x, y, z = _product(_product(q, (0.0, *v)), (q[0], -q[1], -q[2], -q[3]))
    return x, y, z

"""ABB Externally Guided Motion: protobuf messages over UDP, every 4 ms; the controller sends first.

`EGMStreamStart` streams without motion, and kreisel sends no answers, so that nothing can move the robot. The fields
read of an `EgmRobot` message are: header (1): seqno 1, tm 2 (ms); feedBack (2): joints 1 (degrees), cartesian 2:
pos 1 (mm), orient 2 (u0 .. u3), time 4: sec 1, usec 2. All others are skipped.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

from kreisel.errors import ProtocolError
from kreisel.protocols.samples import RobotSample, checked_stamp, finite

MAX_BYTES = 65507  # of a UDP datagram over IPv4: 65535 less the headers, 20 and 8 (RFC 791, RFC 768)
_NAME = "EGM"
_DEGREE = math.pi / 180.0  # rad
_VARINT, _DOUBLE, _BYTES, _FLOAT = 0, 1, 2, 5  # wire types, by the encoding of Protocol Buffers
_DATA = 2  # MSGTYPE_DATA


def decode(datagram: bytes) -> RobotSample:
    """Return the pose in an `EgmRobot` message's feedback; the stamp is the feedback's, or else the header's.

    Raises
    ------
    ProtocolError
        If it is cut, not such a message, or has impossible values.
    """
    message = _fields(datagram)
    header, feedback = _fields(_inner(message, 1)), _fields(_inner(message, 2))
    if not feedback:
        raise ProtocolError(_NAME, f"message of {len(datagram)} bytes without feedback; start EGM with EGMStreamStart")
    time = _fields(_inner(feedback, 4))
    stamp_ns = _whole(header, 2) * 1_000_000
    if 1 in time:
        stamp_ns = _whole(time, 1) * 1_000_000_000 + _whole(time, 2) * 1000
    pose = _fields(_inner(feedback, 2))
    position = quaternion = None
    if pose:
        x, y, z = _doubles(_inner(pose, 1), (1, 2, 3), "position")
        w, i, j, k = _doubles(_inner(pose, 2), (1, 2, 3, 4), "orientation")
        length = math.sqrt(w * w + i * i + j * j + k * k)
        if abs(length - 1.0) > 0.01:
            raise ProtocolError(_NAME, f"the orientation's length is {length:.3g}, expected 1")
        position = (x * 1e-3, y * 1e-3, z * 1e-3)
        quaternion = (w / length, i / length, j / length, k / length)
    joints = tuple(angle * _DEGREE for angle in _joints(_inner(feedback, 1)))
    if not pose and not joints:
        raise ProtocolError(_NAME, "feedback without joints and without a pose")
    return RobotSample(checked_stamp(stamp_ns, _NAME), position, quaternion, joints)


def encode(sample: RobotSample, number: int) -> bytes:
    """Return the `EgmRobot` message with a pose as feedback (simulator's side)."""
    seconds, rest = divmod(sample.stamp_ns, 1_000_000_000)
    parts = [_field(1, b"".join(_double(1, angle / _DEGREE) for angle in sample.joints))]
    if sample.position is not None and sample.quaternion is not None:
        position = b"".join(_double(k, 1e3 * x) for k, x in enumerate(sample.position, start=1))
        orientation = b"".join(_double(k, u) for k, u in enumerate(sample.quaternion, start=1))
        parts.append(_field(2, _field(1, position) + _field(2, orientation)))
    parts.append(_field(4, _number(1, seconds) + _number(2, rest // 1000)))
    tm = sample.stamp_ns // 1_000_000 % 2**32
    header = _number(1, number % 2**32) + _number(2, tm) + _number(3, _DATA)
    return _field(1, header) + _field(2, b"".join(parts)) + _field(4, _number(1, 1)) + _field(8, _number(1, 1))


def _fields(data: bytes) -> dict[int, list[int | float | bytes]]:
    """Return the values of a message by field number."""
    found: dict[int, list[int | float | bytes]] = {}
    for number, value in _walk(data):
        found.setdefault(number, []).append(value)
    return found


def _walk(data: bytes) -> Iterator[tuple[int, int | float | bytes]]:
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == _VARINT:
            value, at = _varint(data, at)
            yield key >> 3, value
            continue
        size = 8 if kind == _DOUBLE else 4 if kind == _FLOAT else 0
        if kind == _BYTES:
            size, at = _varint(data, at)
        elif not size:
            raise ProtocolError(_NAME, f"byte {at} of {len(data)} begins a field of kind {kind}, expected 0, 1, 2 or 5")
        if at + size > len(data):
            raise ProtocolError(_NAME, f"message cut at byte {at}: expected {size} more bytes, got {len(data) - at}")
        part = data[at : at + size]
        at += size
        yield key >> 3, struct.unpack("<d", part)[0] if kind == _DOUBLE else part


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ProtocolError(_NAME, f"message cut at byte {at}, in a number")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ProtocolError(_NAME, f"number of more than 64 bits before byte {at}")


def _inner(fields: dict[int, list[int | float | bytes]], number: int) -> bytes:
    """Return the last inner message with a field number; empty if there is none."""
    value = fields.get(number, [b""])[-1]
    if not isinstance(value, bytes):
        raise ProtocolError(_NAME, f"field {number} is a number, expected a message")
    return value


def _whole(fields: dict[int, list[int | float | bytes]], number: int) -> int:
    value = fields.get(number, [0])[-1]
    if not isinstance(value, int):
        raise ProtocolError(_NAME, f"field {number} is not a whole number")
    return value


def _doubles(data: bytes, numbers: tuple[int, ...], what: str) -> tuple[float, ...]:
    fields = _fields(data)
    values = tuple(fields.get(number, [0.0])[-1] for number in numbers)
    if not all(isinstance(value, float) for value in values):
        raise ProtocolError(_NAME, f"the {what} does not consist of doubles")
    return finite(tuple(float(value) for value in values), _NAME, f"the {what}")


def _joints(data: bytes) -> tuple[float, ...]:
    """Return joint angles in degrees: repeated doubles, single or packed."""
    values: list[float] = []
    for value in _fields(data).get(1, []):
        if isinstance(value, float):
            values.append(value)
        elif isinstance(value, bytes) and len(value) % 8 == 0:
            values += struct.unpack(f"<{len(value) // 8}d", value)
        else:
            raise ProtocolError(_NAME, "the joint angles do not consist of doubles")
    return finite(tuple(values), _NAME, "a joint angle")


def _field(number: int, content: bytes) -> bytes:
    return _encoded(number << 3 | _BYTES) + _encoded(len(content)) + content


def _number(number: int, value: int) -> bytes:
    return _encoded(number << 3 | _VARINT) + _encoded(value)


def _double(number: int, value: float) -> bytes:
    return _encoded(number << 3 | _DOUBLE) + struct.pack("<d", value)


def _encoded(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)

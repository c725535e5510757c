"""KUKAVARPROXY: reading and writing single variables of a KUKA controller over TCP, big-endian.

Request: number u16, length u16, mode u8 (0 read, 1 write), length of name u16, name; for writing also length of value
u16, value. Answer: number, length, mode, length of value, value, three bytes, the last of which is 1 for success.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass

from kreisel.errors import ProtocolError
from kreisel.geometry.kuka import from_abc, to_abc
from kreisel.protocols.framing import Splitter
from kreisel.protocols.samples import RobotSample, finite

MAX_BYTES = 4096  # of a message; chosen: a pose has below 300
READ, WRITE = 0, 1  # modes; see above
_NAME = "KUKAVARPROXY"
_HEAD = struct.Struct(">HH")
_PAIR = re.compile(r"([A-Za-z]\w*)\s+([-+]?[\d.]+(?:[eE][-+]?\d+)?)")
_DEGREE = math.pi / 180.0  # rad


@dataclass(frozen=True, slots=True)
class Request:
    """A request; `value` is None for reading."""

    number: int
    name: str
    value: str | None = None


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer; `well` is whether the request succeeded."""

    number: int
    value: str
    well: bool


def splitter() -> Splitter:
    """Return a splitter of a byte stream into messages: pairs of number and content."""
    return Splitter(_NAME, ">HH", length=1, least=3, most=MAX_BYTES, whole=False)


def encode_request(request: Request) -> bytes:
    """Return the bytes of a request."""
    content = bytes([READ if request.value is None else WRITE]) + _string(request.name)
    if request.value is not None:
        content += _string(request.value)
    return _HEAD.pack(request.number % 2**16, len(content)) + content


def encode_answer(answer: Answer) -> bytes:
    """Return the bytes of an answer (simulator's side)."""
    content = bytes([READ]) + _string(answer.value) + (b"\x00\x01\x01" if answer.well else b"\x00\x00\x00")
    return _HEAD.pack(answer.number % 2**16, len(content)) + content


def decode_request(number: int, content: bytes) -> Request:
    """Return the request of a message.

    Raises
    ------
    ProtocolError
        If it is cut, or has another mode.
    """
    name, rest = _take(content[1:])
    if content[0] == READ and not rest:
        return Request(number, name)
    if content[0] == WRITE:
        value, rest = _take(rest)
        if not rest:
            return Request(number, name, value)
    raise ProtocolError(_NAME, f"request of mode {content[0]} with {len(rest)} bytes too many, expected 0 or 1")


def decode_answer(number: int, content: bytes) -> Answer:
    """Return the answer of a message.

    Raises
    ------
    ProtocolError
        If it is cut.
    """
    value, rest = _take(content[1:])
    if len(rest) != 3:
        raise ProtocolError(_NAME, f"answer ends with {len(rest)} bytes, expected 3")
    return Answer(number, value, rest[-1] == 1)


def pose(text: str, stamp_ns: int) -> RobotSample:
    """Return the pose in a value of ``$POS_ACT`` or ``$AXIS_ACT``, which is in mm and degrees.

    Raises
    ------
    ProtocolError
        If it is neither a frame nor a set of axes.
    """
    try:
        values = {name.upper(): float(number) for name, number in _PAIR.findall(text[:MAX_BYTES])}
    except ValueError as error:
        raise ProtocolError(_NAME, f"'{text[:60]}' holds a value that is not a number") from error
    axes = [values.get(f"A{k}") for k in range(1, 7)]
    if None not in axes:
        return RobotSample(stamp_ns, None, None, tuple(float(axis or 0.0) * _DEGREE for axis in axes))
    try:
        x, y, z, a, b, c = finite(tuple(values[name] for name in "XYZABC"), _NAME, "a frame")
    except KeyError as error:
        raise ProtocolError(_NAME, f"'{text[:60]}' is neither a frame (X .. C) nor axes (A1 .. A6)") from error
    return RobotSample(stamp_ns, (x * 1e-3, y * 1e-3, z * 1e-3), from_abc(a * _DEGREE, b * _DEGREE, c * _DEGREE))


def variable(name: str, sample: RobotSample) -> str | None:
    """Return the text of a variable at a pose, None if there is no such variable (simulator's side)."""
    if name == "$AXIS_ACT" and sample.joints:
        axes = ", ".join(f"A{k} {angle / _DEGREE:.5f}" for k, angle in enumerate(sample.joints, start=1))
        return f"{{E6AXIS: {axes}, E1 0.0, E2 0.0, E3 0.0, E4 0.0, E5 0.0, E6 0.0}}"
    if name == "$POS_ACT" and sample.position is not None and sample.quaternion is not None:
        values = (*(1e3 * x for x in sample.position), *(angle / _DEGREE for angle in to_abc(sample.quaternion)))
        frame = ", ".join(f"{axis} {value:.5f}" for axis, value in zip("XYZABC", values, strict=True))
        return f"{{E6POS: {frame}, S 2, T 10}}"
    return None


def _string(text: str) -> bytes:
    data = text.encode("latin-1", "replace")
    return struct.pack(">H", len(data)) + data


def _take(content: bytes) -> tuple[str, bytes]:
    if len(content) < 2:
        raise ProtocolError(_NAME, "message is cut before a length")
    (length,) = struct.unpack_from(">H", content)
    if len(content) < 2 + length:
        raise ProtocolError(_NAME, f"string of {length} bytes, got {len(content) - 2}")
    return content[2 : 2 + length].decode("latin-1"), content[2 + length :]

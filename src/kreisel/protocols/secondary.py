"""State messages of a Universal Robots controller on its script ports, 30001 and 30002, about ten times a second.

Packages, big-endian: size u32, kind u8; kind 16 is the robot's state, which consists of parts with the same head.
Part 0 is the robot's mode: time u64, then single bytes: connected, enabled, power on, emergency stopped, protective
stopped, program running, program paused. All other packages and parts are skipped.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from kreisel.errors import ProtocolError
from kreisel.protocols.framing import Splitter

MAX_BYTES = 1 << 20
"""Largest number of bytes of a package."""

_HEAD = struct.Struct(">IB")
_STATE, _MODE = 16, 0  # kinds of a package and of a part; see above
_FLAGS = struct.Struct(">Q7B")


class Client:
    """The client's side of one connection: it reads only. Bytes that are not packages end its reading without error."""

    def __init__(self) -> None:
        self._splitter: Splitter | None = Splitter(
            "URScript", ">IB", length=0, least=_HEAD.size, most=MAX_BYTES, whole=True
        )

    def receive(self, data: bytes) -> str:
        """Return the reported state in which the arm must not move, from the newest bytes; empty if there is none."""
        if self._splitter is None:
            return ""
        try:
            packages = self._splitter.receive(data)
        except ProtocolError:  # another interface or controller; RTDE reports the state as well
            self._splitter = None
            return ""
        found = [flags for kind, content in packages if kind == _STATE for flags in _flags(content)]
        return _blocked(found[-1]) if found else ""


def _flags(content: bytes) -> Iterator[tuple[int, ...]]:
    """Yield the flags of the parts that report the robot's mode."""
    at = 0
    while at + _HEAD.size <= len(content):
        size, kind = _HEAD.unpack_from(content, at)
        if size < _HEAD.size or at + size > len(content):
            return
        if kind == _MODE and size >= _HEAD.size + _FLAGS.size:
            yield _FLAGS.unpack_from(content, at + _HEAD.size)[1:]
        at += size


def _blocked(flags: tuple[int, ...]) -> str:
    if any(flag not in (0, 1) for flag in flags):
        return ""
    emergency, protective = flags[3:5]
    return "emergency stop" if emergency else "protective stop" if protective else ""


def encode_state(time_us: int, *, emergency: bool = False, protective: bool = False) -> bytes:
    """Return the package of a state (simulator's side)."""
    flags = _FLAGS.pack(time_us, 1, 1, 1, emergency, protective, 0, 0)
    part = _HEAD.pack(_HEAD.size + len(flags), _MODE) + flags
    return _HEAD.pack(_HEAD.size + len(part), _STATE) + part

"""Telegrams between a PC and kreisel's program on a KUKA controller: XML over EthernetKRL (TCP), or a serial line.

The PC sends moves and stops, ``<Kreisel><Move>…</Move></Kreisel>`` or ``<Kreisel><Stop>…``, and over EthernetKRL a
heartbeat, ``<Kreisel><Beat>…``, without which the program brakes; the controller sends states, ``<Robot>…``. Angles are
degrees, lengths mm, A, B, C intrinsic rotations about z, y', x'', times ms of a timer of the program. Values are in
elements, not in attributes, so that both EthernetKRL and a format of CREAD can read them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar
from xml.etree.ElementTree import Element

from kreisel.errors import ProtocolError
from kreisel.geometry.kuka import from_abc, to_abc
from kreisel.protocols.rsi import parse_xml
from kreisel.protocols.samples import RobotSample, checked_stamp, finite

MAX_BYTES = 4096
"""Largest number of bytes of a telegram."""

_NAME = "EthernetKRL"
_DEGREE = math.pi / 180.0  # rad
_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_FRAME = ("X", "Y", "Z", "A", "B", "C")
_MAX_NUMBER = 2**31 - 1  # largest INT of KRL: 32 bits with a sign


class Doing(IntEnum):
    """What the program is doing, or did last."""

    ARRIVED = 0
    MOVING = 1
    STOPPED = 2
    REFUSED = 3


@dataclass(frozen=True)
class Move:
    """A move to joint angles, rad, at a share of the axes' full speed; the states refer to its number."""

    number: int
    target: tuple[float, ...]
    share: float


@dataclass(frozen=True)
class Stop:
    """A stop at the present position."""

    number: int


@dataclass(frozen=True)
class Beat:
    """A heartbeat: the PC lives."""


BEAT_INTERVAL = 0.1
"""s between two heartbeats."""

BEAT_PATIENCE = 0.3
"""s without one after which the program brakes; `kr_patience` in kreisel.dat. Chosen: three heartbeats."""

Command = Move | Stop | Beat


@dataclass(frozen=True)
class State:
    """What the program is doing, the number of the command it refers to, and the present pose of the arm."""

    number: int
    doing: Doing
    sample: RobotSample


def encode(command: Command) -> bytes:
    """Return the telegram of a command."""
    if isinstance(command, Beat):
        return b"<Kreisel><Beat></Beat></Kreisel>"
    if isinstance(command, Stop):
        return f"<Kreisel><Stop><Id>{command.number}</Id></Stop></Kreisel>".encode()
    axes = "".join(f"<{name}>{angle / _DEGREE:.5f}</{name}>" for name, angle in zip(_AXES, command.target, strict=True))
    return f"<Kreisel><Move><Id>{command.number}</Id><V>{100.0 * command.share:.3f}</V>{axes}</Move></Kreisel>".encode()


def decode(telegram: bytes) -> Command:
    """Return the command of a telegram (controller's side).

    Raises
    ------
    ProtocolError
        If it is invalid, or has impossible values.
    """
    root = parse_xml(telegram, _NAME, "Kreisel")
    parts = [part.tag for part in root]
    if parts == ["Beat"]:
        return Beat()
    if parts == ["Stop"]:
        return Stop(_whole(root[0], "Id", _MAX_NUMBER))
    if parts != ["Move"]:
        raise ProtocolError(_NAME, f"<Kreisel> holds {', '.join(parts)[:60] or 'nothing'}, expected Move, Stop or Beat")
    share = _numbers(root[0], ("V",))[0] / 100.0
    if not 0.0 < share <= 1.0:
        raise ProtocolError(_NAME, f"a move at {100.0 * share:g} per cent of full speed, expected above 0 to 100")
    target = tuple(angle * _DEGREE for angle in _numbers(root[0], _AXES))
    return Move(_whole(root[0], "Id", _MAX_NUMBER), target, share)


def encode_state(state: State) -> bytes:
    """Return the telegram of a state (controller's side)."""
    sample = state.sample
    parts = [f"<Robot><Id>{state.number}</Id><Do>{int(state.doing)}</Do><T>{round(sample.stamp_ns * 1e-6)}</T>"]
    values = dict(zip(_AXES, (angle / _DEGREE for angle in sample.joints), strict=False))
    if sample.position is not None and sample.quaternion is not None:
        turns = (angle / _DEGREE for angle in to_abc(sample.quaternion))
        values |= dict(zip(_FRAME, (*(1e3 * x for x in sample.position), *turns), strict=True))
    parts += [f"<{name}>{value:.5f}</{name}>" for name, value in values.items()]
    return "".join([*parts, "</Robot>"]).encode()


def decode_state(telegram: bytes) -> State:
    """Return the state in a telegram.

    Raises
    ------
    ProtocolError
        If it is invalid, or has impossible values.
    """
    root = parse_xml(telegram, _NAME, "Robot")
    doing = _whole(root, "Do", max(Doing))
    joints = tuple(angle * _DEGREE for angle in _numbers(root, _AXES))
    position = quaternion = None
    if root.find("X") is not None:
        x, y, z, *turns = _numbers(root, _FRAME)
        position, quaternion = (x * 1e-3, y * 1e-3, z * 1e-3), from_abc(*(angle * _DEGREE for angle in turns))
    stamp = checked_stamp(_whole(root, "T", _MAX_NUMBER) * 1_000_000, _NAME)
    return State(_whole(root, "Id", _MAX_NUMBER), Doing(doing), RobotSample(stamp, position, quaternion, joints))


Content = TypeVar("Content")


class Splitter:
    """Splits a byte stream into telegrams, in chunks of any size; bytes between telegrams are counted.

    Parameters
    ----------
    root
        Name of a telegram's root element: `Robot` for a PC, `Kreisel` for a controller.

    Attributes
    ----------
    skipped
        Number of bytes that belong to no telegram.
    """

    def __init__(self, root: str) -> None:
        self.skipped = 0
        self._begin, self._end = f"<{root}>".encode(), f"</{root}>".encode()
        self._buffer = bytearray()

    def receive(self, data: bytes) -> list[bytes]:
        """Return the telegrams that are now complete."""
        self._buffer += data
        return list(self._whole())

    def _whole(self) -> Iterator[bytes]:
        while True:
            begin = self._buffer.find(self._begin)
            if begin < 0:
                keep = len(self._begin) - 1
                self._skip(max(len(self._buffer) - keep, 0))
                return
            self._skip(begin)
            end = self._buffer.find(self._end)
            again = self._buffer.find(self._begin, 1, end if end >= 0 else len(self._buffer))
            if again >= 0:  # the first one was cut
                self._skip(again)
                continue
            if end < 0:
                if len(self._buffer) > MAX_BYTES:
                    self._skip(len(self._begin))
                    continue
                return
            size = end + len(self._end)
            telegram = bytes(self._buffer[:size])
            del self._buffer[:size]
            yield telegram

    def _skip(self, size: int) -> None:
        between = bytes(self._buffer[:size])
        self.skipped += len(between) - sum(map(len, re.findall(rb"\s", between)))
        del self._buffer[:size]


def _whole(element: Element, tag: str, largest: int) -> int:
    text = (element.findtext(tag) or "").strip()
    if not (text.isascii() and text.isdigit()) or len(text) > 10 or int(text) > largest:
        raise ProtocolError(_NAME, f"<{tag}> is '{text[:40]}', expected a whole number up to {largest}")
    return int(text)


def _numbers(element: Element, names: tuple[str, ...]) -> tuple[float, ...]:
    texts = [(element.findtext(name) or "").strip() for name in names]
    try:
        values = tuple(float(text) for text in texts)
    except ValueError as error:
        wrong = ", ".join(f"<{name}> is '{text[:20]}'" for name, text in zip(names, texts, strict=True))
        raise ProtocolError(_NAME, f"{wrong}: expected numbers") from error
    return finite(values, _NAME, f"<{element.tag}>")

"""Lines of URScript that move a Universal Robots arm, and the decoder that the simulator uses."""

from __future__ import annotations

import re
from dataclasses import dataclass

from kreisel.errors import ProtocolError

_NAME = "URScript"
_NUMBER = r"\s*[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?\s*"
_MOVE = re.compile(rf"movej\(\[({_NUMBER}(?:,{_NUMBER}){{5}})\],a=({_NUMBER}),v=({_NUMBER})\)")
MAX_BYTES = 4096  # of a line; chosen: a move of six joints has below 200


@dataclass(frozen=True)
class JointMove:
    """A move to joint angles, rad, with the leading joint's acceleration and speed, rad/s^2 and rad/s."""

    target: tuple[float, ...]
    acceleration: float
    speed: float


@dataclass(frozen=True)
class Stop:
    """A stop at the present position, with a deceleration in rad/s^2."""

    deceleration: float = 4.0


Command = JointMove | Stop


def encode(command: Command) -> bytes:
    """Return the line of a command."""
    if isinstance(command, Stop):
        return f"stopj({command.deceleration:.4f})\n".encode()
    joints = ", ".join(f"{angle:.9f}" for angle in command.target)
    return f"movej([{joints}],a={command.acceleration:.4f},v={command.speed:.4f})\n".encode()


def decode(line: bytes) -> Command:
    """Return the command of a line.

    Raises
    ------
    ProtocolError
        If it is neither a move nor a stop.
    """
    text = line[:MAX_BYTES].decode("ascii", "replace").strip()
    move = _MOVE.fullmatch(text)
    if move is not None:
        joints = tuple(float(angle) for angle in move.group(1).split(","))
        return JointMove(joints, float(move.group(2)), float(move.group(3)))
    stop = re.fullmatch(rf"stopj\(({_NUMBER})\)", text)
    if stop is not None:
        return Stop(float(stop.group(1)))
    raise ProtocolError(_NAME, f"'{text[:60]}' is neither movej([…],a=…,v=…) nor stopj(…)")

"""URScript that moves a Universal Robots arm, and the decoder that the simulator uses.

A move is a program of its own, which begins with a watchdog: the controller stops it when the named RTDE register is no
longer written. A watchdog ends with its program. Blocks end with ``end``; indentation has no meaning, and is not sent.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from kreisel.errors import ProtocolError

_NAME = "URScript"
_NUMBER = r"\s*[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?\s*"
_WATCHDOG = re.compile(rf'rtde_set_watchdog\("(\w+)",({_NUMBER}),"stop"\)')
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


@dataclass(frozen=True)
class Watchdog:
    """A watchdog: the RTDE input that must be written, and how often at least, Hz; otherwise the program is stopped."""

    register: str
    least: float


Command = JointMove | Stop


def encode(command: Command, watchdog: Watchdog | None = None) -> bytes:
    """Return the text of a command: a line, or with a watchdog a program."""
    if isinstance(command, Stop):
        return f"stopj({command.deceleration:.4f})\n".encode()
    joints = ", ".join(f"{angle:.9f}" for angle in command.target)
    move = f"movej([{joints}],a={command.acceleration:.4f},v={command.speed:.4f})\n"
    if watchdog is None:
        return move.encode()
    guard = f'rtde_set_watchdog("{watchdog.register}",{watchdog.least:g},"stop")\n'
    return f"def kreisel():\n{guard}{move}end\n".encode()


def decode_watchdog(line: bytes) -> Watchdog | None:
    """Return the watchdog that a line sets, or None if it sets none."""
    found = _WATCHDOG.fullmatch(line[:MAX_BYTES].decode("ascii", "replace").strip())
    return None if found is None else Watchdog(found.group(1), float(found.group(2)))


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

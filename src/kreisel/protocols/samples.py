"""Samples that the protocols decode: one reading of an IMU, one pose of a robot, on the device's own clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from kreisel.errors import ProtocolError

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]

LAST_STAMP_NS = 2**31 * 10**9 - 1
"""Largest stamp; larger ones do not fit into the header of a recorded message."""


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Raw angular rate (rad/s) and acceleration (m/s^2)."""

    stamp_ns: int
    rate: Triple
    acceleration: Triple


@dataclass(frozen=True, slots=True)
class RobotSample:
    """Position (m) and attitude q_rb of the tool, and joint angles (rad); None or empty if not reported.

    Attributes
    ----------
    blocked
        State of the controller in which the arm must not or cannot move, in words; empty if it reports none.
    running
        Whether the controller runs a program; None if not reported.
    holds
        Whether the controller runs a program, or has paused one that it may continue; None if not reported.
    """

    stamp_ns: int
    position: Triple | None
    quaternion: Quadruple | None
    joints: tuple[float, ...] = ()
    blocked: str = field(default="", compare=False)
    running: bool | None = field(default=None, compare=False)
    holds: bool | None = field(default=None, compare=False)


def checked_stamp(stamp_ns: int, protocol: str) -> int:
    """Return the stamp, checked to be recordable.

    Raises
    ------
    ProtocolError
        If it is negative or too large.
    """
    if not 0 <= stamp_ns <= LAST_STAMP_NS:
        raise ProtocolError(protocol, f"the time stamp {stamp_ns} ns is impossible, expected 0 to {LAST_STAMP_NS} ns")
    return stamp_ns


def finite(values: tuple[float, ...], protocol: str, what: str) -> tuple[float, ...]:
    """Return the values, checked to be finite.

    Raises
    ------
    ProtocolError
        If one is not.
    """
    if not all(math.isfinite(value) for value in values):
        raise ProtocolError(protocol, f"{what} is not finite: {values}")
    return values

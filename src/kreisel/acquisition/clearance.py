"""A program against the room: speed of the tool, floor, keep-out boxes, and the arm's links against each other.

The path is straight in joint angles. Links are capsules about the lines between joints: a model holds no shapes.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from kreisel.acquisition.movers import Mover
from kreisel.acquisition.preflight import CHECKED, approach_share
from kreisel.errors import RobotError, SettingsError
from kreisel.geometry.rotation import Array, lengths
from kreisel.robot.description import Arm
from kreisel.robot.kinematics import poses, skeleton
from kreisel.robot.program import Program

RADIUS = 0.06
"""m; of the capsules about the links. Chosen: a slim arm of ten kilograms' payload; thicker ones come closer."""

_STEP = math.radians(2.0)
"""rad of the leading joint between two looks at a move."""

_APART = 0.3
"""m along the arm between two links that may touch; closer ones are one wrist."""

_SHORTEST = 0.01
"""m; shorter lines between joints are no links."""


@dataclass(frozen=True)
class Room:
    """What the arm must not touch, in the base's frame.

    Attributes
    ----------
    floor
        Height of the floor, m.
    boxes : each (2, 3)
        Lowest and highest corner of keep-out boxes, m.
    """

    floor: float = 0.0
    boxes: tuple[Array, ...] = ()


def parse_box(text: str) -> Array:
    """Return the corners (2, 3) of a box that is written as six numbers, ``x,y,z,x,y,z``, m.

    Raises
    ------
    SettingsError
        If it is something else.
    """
    try:
        corners = np.array([float(part) for part in text.split(",")]).reshape(2, 3)
    except ValueError:
        corners = np.full((2, 3), math.nan)
    if not np.isfinite(corners).all():
        raise SettingsError(f"--keep-out '{text}': expected two corners, x,y,z,x,y,z, in m in the base's frame")
    return np.sort(corners, axis=0)


def slowed(arm: Arm, program: Program, mover: Mover, tool_speed: float) -> tuple[Program, str]:
    """Return the program as it is sent: the first moves slow, the tool never too fast; and what was lowered, in words.

    tool_speed: the fastest allowed, m/s.
    """
    slow, moves, lowered = approach_share(program, mover), [], []
    for number, at, move in program.legs():
        share = min(move.speed, slow) if number <= CHECKED else move.speed
        fastest = tool_peak(arm, mover, at, move.target, share)
        if fastest > tool_speed:
            share *= tool_speed / fastest
            lowered.append((number, fastest))
        moves.append(replace(move, speed=share))
    sent = replace(program, moves=tuple(moves))
    if not lowered:
        return sent, f"the tool stays below {tool_speed:g} m/s"
    number, fastest = max(lowered, key=lambda one: one[1])
    return sent, (
        f"{len(lowered)} moves are slowed down, so that the tool stays below {tool_speed:g} m/s (it would reach "
        f"{fastest:.2g} m/s in move {number}); --tool-speed allows more, and calibration gains by it"
    )


def as_moved(arm: Arm, program: Program, mover: Mover) -> Program:
    """Return the program whose moves have, as shares of the model's velocities, the speeds that a mover commands."""
    moves = []
    for _, at, move in program.legs():
        way = move.target - at
        peaks = mover.peaks(way, move.speed, arm.velocity)[0]
        share = 1.0 if not way.any() else float(np.max(np.abs(peaks) / arm.velocity))
        moves.append(replace(move, speed=min(1.0, share)))
    return replace(program, moves=tuple(moves))


def tool_peak(arm: Arm, mover: Mover, start: Array, target: Array, share: float) -> float:
    """Return the largest speed of the tool in a move, m/s."""
    way = target - start
    if not np.any(way):
        return 0.0
    path = _path(start, target)
    steps = lengths(np.diff(poses(arm, path)[0], axis=0))
    peak = float(np.max(np.abs(mover.peaks(way, share, arm.velocity)[0])))
    return float(np.max(steps)) * (len(path) - 1) * peak / float(np.max(np.abs(way)))


def check_room(arm: Arm, program: Program, room: Room) -> str:
    """Return how close the program's moves come to the floor and the arm to itself.

    Raises
    ------
    RobotError
        If it touches; names the move, the place, and the option that says otherwise.
    """
    lowest = closest = math.inf
    for number, at, move in program.legs():
        low, close = check_way(arm, at, move.target, room, number)
        lowest, closest = min(lowest, low), min(closest, close)
    return (
        f"the arm stays {lowest:.2f} m above the floor (at {room.floor:g} m of the base, --floor), and its links "
        f"{closest:.2f} m apart (capsules of {1e3 * RADIUS:.0f} mm radius; not the tool, cables, or what stands around)"
    )


def check_way(arm: Arm, start: Array, target: Array, room: Room, number: int) -> tuple[float, float]:
    """Return the smallest height above the floor, and the smallest distance between two links, in one move, m.

    Raises
    ------
    RobotError
        If the arm touches anything; see `check_room`.
    """
    lowest = closest = math.inf
    for angles in _path(start, target):
        links = _links(skeleton(arm, angles))
        lowest = min(lowest, _check_height(links, room.floor, number))
        closest = min(closest, _check_apart(links, number))
        for box in room.boxes:
            _check_box(links, box, number)
    return lowest, closest


def approach(arm: Arm, program: Program, mover: Mover, joints: Array, room: Room, tool_speed: float) -> float:
    """Return the share of full speed at which the arm goes from where it stands to the program's start, move 0.

    Raises
    ------
    RobotError
        If it would touch anything on the way.
    """
    check_way(arm, joints, program.start, room, 0)
    share = approach_share(program, mover)
    fastest = tool_peak(arm, mover, joints, program.start, share)
    return share * min(1.0, tool_speed / fastest) if fastest > 0.0 else share


def _path(start: Array, target: Array) -> Array:
    """Return joint angles along a move, (n, joints), both ends included."""
    count = max(2, math.ceil(float(np.max(np.abs(target - start))) / _STEP) + 1)
    return start + np.linspace(0.0, 1.0, count)[:, None] * (target - start)


Link = tuple[Array, Array, float]
"""Both ends, m, and the distance of the first from the base along the arm."""


def _links(points: Array) -> list[Link]:
    out, along = [], 0.0
    for begin, end in itertools.pairwise(points):
        length = float(np.linalg.norm(end - begin))
        if length > _SHORTEST:
            out.append((begin, end, along))
        along += length
    return out


def _check_height(links: list[Link], floor: float, number: int) -> float:
    """Return the height of the lowest link above the floor; the first, on which the arm stands, does not count."""
    lowest = min(float(min(begin[2], end[2])) for begin, end, _ in links[1:]) - RADIUS - floor
    if lowest < 0.0:
        raise RobotError(
            f"move {number} brings the arm {-lowest:.2f} m below the floor, which is taken to be at {floor:g} m in the "
            f"base's frame; if it is lower, give --floor {floor + lowest - 0.05:.2f}"
        )
    return lowest


def _check_apart(links: list[Link], number: int) -> float:
    """Return the smallest distance between the surfaces of links that are not neighbours."""
    closest = math.inf
    for i, first in enumerate(links):
        reached = first[2] + float(np.linalg.norm(first[1] - first[0]))
        for second in links[i + 2 :]:
            if second[2] - reached > _APART:
                closest = min(closest, _distance(first, second) - 2.0 * RADIUS)
    if closest < 0.0:
        raise RobotError(
            f"move {number} folds the arm onto itself: two links come within {2e2 * RADIUS:.0f} cm of each other"
        )
    return closest


def _check_box(links: list[Link], box: Array, number: int) -> None:
    for begin, end, _ in links[1:]:
        for share in np.linspace(0.0, 1.0, 9):
            point = begin + share * (end - begin)
            if np.all(point > box[0] - RADIUS) and np.all(point < box[1] + RADIUS):
                low, high = (", ".join(f"{x:g}" for x in corner) for corner in box)
                raise RobotError(f"move {number} brings the arm into the keep-out box from ({low}) to ({high}) m")


def _distance(first: Link, second: Link) -> float:
    """Return the distance of two segments, m: the least of the four ends and of the lines where both run past."""
    (a, b, _), (c, d, _) = first, second
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = u @ u, u @ v, v @ v, u @ w, v @ w
    bend = uu * vv - uv * uv
    s = float(np.clip((uv * vw - vv * uw) / bend, 0.0, 1.0)) if bend > 1e-12 * uu * vv else 0.0
    t = float(np.clip((uv * s + vw) / vv, 0.0, 1.0))
    s = float(np.clip((uv * t - uw) / uu, 0.0, 1.0))
    return float(np.linalg.norm(w + s * u - t * v))

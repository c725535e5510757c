"""Programs: files of poses and standstills that an operator writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import RobotError, SettingsError, unknown_name
from kreisel.files import read_toml
from kreisel.geometry.kuka import from_abc
from kreisel.geometry.rotation import Array
from kreisel.robot.description import Arm
from kreisel.robot.excitation import home
from kreisel.robot.kinematics import check_range, inverse
from kreisel.robot.motion import Move
from kreisel.units import DEG

EXAMPLE = """\
# A program: moves from rest to rest. Targets are joint angles, or poses of the tool in the base's frame.
start_deg = [0, -90, 90, 0, 30, 0]     # joint angles of the arm at the beginning

[[move]]
joints_deg = [30, -70, 80, 20, 50, 40]
rest = 1.5                             # s at standstill at the target
speed = 0.8                            # share of the limits

[[move]]
position = [1.5, 0.4, 1.6]             # m
abc_deg = [20, 70, 10]                 # KUKA's A, B, C: rotations about Z, Y', X''
rest = 2.0
"""

_KEYS = ("joints_deg", "position", "abc_deg", "rest", "speed")


@dataclass(frozen=True)
class Program:
    """Joint angles at the start (joints,), and the moves."""

    start: Array
    moves: tuple[Move, ...]

    def legs(self) -> Iterator[tuple[int, Array, Move]]:
        """Yield the number of each move, from 1, the joint angles at which it begins, and the move."""
        at = self.start
        for number, move in enumerate(self.moves, start=1):
            yield number, at, move
            at = move.target


def read_program(path: Path, arm: Arm) -> Program:
    """Return the program in a TOML file, its poses as joint angles of an arm.

    Raises
    ------
    SettingsError
        If the file cannot be read, or has unknown keys.
    RobotError
        If a pose is out of reach or range; the message names the move, the joint and the limit.
    """
    example = "`kreisel simulate --example-program` prints one"
    content = read_toml(path, example, lambda text: SettingsError(f"{path}: {text}"))
    for key in content:
        if key not in ("start_deg", "move"):
            raise SettingsError(f"{path}: {unknown_name('key', key, ('start_deg', 'move'))}")
    moves = content.get("move", [])
    if not isinstance(moves, list) or not moves:
        raise SettingsError(f"{path}: no moves; write at least one [[move]]")
    start = home(arm)
    if "start_deg" in content:
        start = DEG * _numbers(content["start_deg"], len(arm.joints), f"{path}: start_deg")
    _checked(arm, start, f"{path}: start_deg")
    out: list[Move] = []
    at = start
    for number, table in enumerate(moves, start=1):
        place = f"{path}: move {number}"
        at = _target(table, arm, at, place)
        _checked(arm, at, place)
        rest, speed = (
            _number(table.get("rest", 1.5), f"{place}: rest"),
            _number(table.get("speed", 1.0), f"{place}: speed"),
        )
        if not (0.0 <= rest <= 3600.0 and 0.01 <= speed <= 1.0):
            raise SettingsError(f"{place}: rest {rest:g} s, speed {speed:g}; expected 0 to 3600 s, and 0.01 to 1")
        out.append(Move(at, rest, speed))
    return Program(start, tuple(out))


def _target(table: Any, arm: Arm, near: Array, place: str) -> Array:
    if not isinstance(table, dict):
        raise SettingsError(f"{place}: expected a table: write [[move]]")
    for key in table:
        if key not in _KEYS:
            raise SettingsError(f"{place}: {unknown_name('key', key, _KEYS)}")
    if "joints_deg" in table:
        return np.asarray(DEG * _numbers(table["joints_deg"], len(arm.joints), f"{place}: joints_deg"))
    if "position" not in table or "abc_deg" not in table:
        raise SettingsError(f"{place}: expected joints_deg, or position with abc_deg")
    position = _numbers(table["position"], 3, f"{place}: position")
    try:
        return inverse(
            arm, position, np.array(from_abc(*(DEG * _numbers(table["abc_deg"], 3, f"{place}: abc_deg")))), near
        )
    except RobotError as error:
        raise RobotError(f"{place}: {error}") from error


def _checked(arm: Arm, angles: Array, place: str) -> None:
    try:
        check_range(arm, angles)
    except RobotError as error:
        raise RobotError(f"{place}: {error}") from error


def _numbers(value: Any, count: int, place: str) -> Array:
    if not isinstance(value, list) or len(value) != count:
        raise SettingsError(f"{place}: {value!r}; expected {count} numbers in brackets")
    return np.array([_number(v, place) for v in value])


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
        raise SettingsError(f"{place}: {repr(value)[:40]} is not a number, or beyond a million")
    return float(value)

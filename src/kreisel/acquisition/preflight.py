"""Checks before an arm is moved: limits, the path to the start, and the model against the controller's data."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np

from kreisel.acquisition.motion_watch import MARGIN, OVERDUE
from kreisel.acquisition.movers import Mover
from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array
from kreisel.protocols.samples import RobotSample
from kreisel.robot.agreement import tool_of
from kreisel.robot.description import Arm
from kreisel.robot.program import Program

SLOW = 0.25
"""rad/s; speed of the leading joint to the program's start and in the first move, while poses are compared."""

CHECKED = 1
"""Number of the last move that is slow: see `clearance.slowed`."""

_ROUNDING = 1e-6
"""Share of a limit by which a value may exceed it. Chosen: a speed equal to its limit is allowed, with the rounding of
float64 (1e-16) and of decimal numbers in descriptions; far below what an arm can follow."""


@dataclass(frozen=True)
class Allowed:
    """Limits set by the user.

    Attributes
    ----------
    approach
        Largest distance of a joint from the program's start, rad.
    tool
        Length of the longest tool that may explain a reported pose, m; None if the base is unknown, too.
    tool_speed
        Fastest speed of the tool, m/s.
    silence
        Seconds without joint angles, or without readings of the IMU, after which the arm is stopped.
    """

    approach: float = math.radians(10.0)
    tool: float | None = 0.3
    tool_speed: float = math.inf
    silence: float = OVERDUE


def approach_share(program: Program, mover: Mover) -> float:
    """Return the share of full speed at which the arm goes to the program's start."""
    return min(min(move.speed for move in program.moves), SLOW / mover.full_speed)


def check_program(arm: Arm, program: Program, mover: Mover) -> str:
    """Return a summary of the check of a program's moves against the model's limits.

    Raises
    ------
    RobotError
        If a move exceeds a limit; names the move, the joint, the limit and an admissible speed.
    """
    for name, limit in zip(arm.joints, arm.velocity, strict=True):
        if not 0.0 < limit < math.inf:
            raise RobotError(
                f"{name} has no velocity limit in the model '{arm.name}', expected <limit velocity=…> in rad/s"
            )
    slow = approach_share(program, mover)
    _check_margin(arm, program.start, "the program's start")
    for number, at, move in program.legs():
        _check_margin(arm, move.target, f"move {number}")
        share = min(move.speed, slow) if number <= CHECKED else move.speed
        check_move(arm, mover, move.target - at, share, f"move {number}")
    return (
        f"checked against the model '{arm.name}': angles, velocities and accelerations of {len(program.moves)} moves "
        f"are within its limits ({_limits_known(arm)})"
    )


def check_move(arm: Arm, mover: Mover, way: Array, share: float, name: str) -> None:
    """Check the peak velocities and accelerations of a move of the joints by `way`, rad.

    Raises
    ------
    RobotError
        If a limit of the model is exceeded.
    """
    velocities, accelerations = mover.peaks(way, share, arm.velocity)
    pairs = [("moves at", "rad/s", velocities, arm.velocity)]
    if accelerations is not None:
        pairs.append(("accelerates with", "rad/s^2", accelerations, acceleration_limits(arm)))
    for does, unit, values, limits in pairs:
        over = values / limits
        k = int(np.argmax(over))
        if over[k] > 1.0 + _ROUNDING:
            fitting = math.floor(100.0 * mover.full_speed / over[k]) / 100.0
            raise RobotError(
                f"{name}: {arm.joints[k]} {does} {values[k]:.2f} {unit}, and its limit in the model '{arm.name}' is "
                f"{limits[k]:.2f} {unit}; give --speed {fitting:g} or less"
            )


def check_state(arm: Arm, program: Program, sample: RobotSample, mover: Mover, allowed: Allowed) -> list[str]:
    """Return a summary of the checks of the controller's report, before the first move.

    Raises
    ------
    RobotError
        If the arm is too far from the program's start, or the model is not that of this robot.
    """
    if len(sample.joints) != len(arm.joints):
        raise RobotError(
            f"the robot reports {len(sample.joints)} joint angles, and the model '{arm.name}' has {len(arm.joints)} "
            "joints; give the description of this robot with --model"
        )
    joints = np.array(sample.joints)
    _check_margin(arm, joints, "the arm now")
    pose_text = _check_pose(arm, sample, allowed)
    way = program.start - joints
    _check_way(arm, program, way, allowed)
    check_move(arm, mover, way, approach_share(program, mover), "the path to the start")
    return [pose_text, f"the program's start is {_degrees(np.max(np.abs(way)))} deg away (joints: {_list(way)} deg)"]


def _check_way(arm: Arm, program: Program, way: Array, allowed: Allowed) -> None:
    k = int(np.argmax(np.abs(way)))
    if abs(way[k]) > allowed.approach:
        raise RobotError(
            f"{arm.joints[k]} is {_degrees(abs(way[k]))} deg from the program's start (all joints: {_list(way)} deg), "
            f"expected at most {_degrees(allowed.approach)} deg; move the arm to [{_list(program.start)}] deg by hand, "
            f"or check that the path to the start is clear, and give --approach {math.ceil(math.degrees(abs(way[k])))}"
        )


def _check_pose(arm: Arm, sample: RobotSample, allowed: Allowed) -> str:
    """Return how the reported pose compares with the model's."""
    tool = tool_of(arm, sample)
    if tool is None:
        return "the controller reports no pose: it is not compared with the model"
    explained = (
        f"a tool of {1e3 * tool.length:.0f} mm, turned by {math.degrees(tool.angle):.1f} deg"
        f"{', with the base turned by 180 deg about z' if tool.turned else ''}"
    )
    if allowed.tool is not None and tool.length > allowed.tool:
        raise RobotError(
            f"the reported pose is that of the model '{arm.name}' only with {explained}: is it another robot? Give its "
            f"description with --model, or allow such a tool with --longest-tool {math.ceil(10 * tool.length) / 10:g}"
        )
    if allowed.tool is None:
        return (
            f"the model '{arm.name}' has as many joints, and the angles are within its limits; base and tool of the "
            "controller are not known: poses are compared while the arm moves"
        )
    return (
        f"the reported pose is that of the model '{arm.name}' with {explained}; whether the tool is constant is "
        "compared while the arm moves"
    )


def _check_margin(arm: Arm, angles: Array, name: str) -> None:
    for joint, angle, low, high in zip(arm.joints, angles, arm.lower, arm.upper, strict=True):
        if not low + MARGIN < angle < high - MARGIN:
            raise RobotError(
                f"{name}: {joint} at {_degrees(angle)} deg is not within its limits in the model '{arm.name}', "
                f"{_degrees(low)} to {_degrees(high)} deg, less one degree; at that margin the arm is stopped"
            )


def _limits_known(arm: Arm) -> str:
    given = _given_accelerations(arm)
    if len(given) == len(arm.joints):
        return "with the acceleration limits of the model"
    return "without acceleration limits in the model: reaching full speed in half a second is taken as the limit"


def acceleration_limits(arm: Arm) -> Array:
    """Return limits of the joints' accelerations, rad/s^2: the model's, or full speed in half a second."""
    given = _given_accelerations(arm)
    return np.array([given.get(name, usual) for name, usual in zip(arm.joints, arm.velocity / 0.5, strict=True)])


def _given_accelerations(arm: Arm) -> dict[str, float]:
    found = {}
    for joint in ElementTree.fromstring(arm.urdf).iter("joint"):
        limit = joint.find("limit")
        value = None if limit is None else limit.get("acceleration")
        if value is not None and float(value) > 0.0:
            found[str(joint.get("name"))] = float(value)
    return {name: value for name, value in found.items() if name in arm.joints}


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.1f}"


def _list(angles: Array) -> str:
    return ", ".join(_degrees(angle) for angle in angles)

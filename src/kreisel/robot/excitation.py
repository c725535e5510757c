"""Motions that make an IMU's parameters observable: all six sensors are excited between any two standstills."""

from __future__ import annotations

import numpy as np

from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array, conjugate, log, matrix, multiply
from kreisel.robot import kinematics
from kreisel.robot.description import Arm
from kreisel.robot.motion import Limits, Move, Plan, Planner

_CANDIDATES, _MANY = 12, 400
"""Targets from which the best is taken, and most that are drawn until one is clear."""

_MAX_HALF_RANGE = np.pi
"""rad; larger ranges of joints are used only up to this angle in both directions."""


def home(arm: Arm) -> Array:
    """Return joint angles (joints,) well inside the ranges, wrist bent, where the motion begins."""
    low, high = _ranges(arm, 1.0)
    q = 0.5 * (low + high)
    return np.where(high - low > 4.0, 0.3, q)


def random_plan(
    rng: np.random.Generator,
    arm: Arm,
    limits: Limits,
    seconds: float,
    *,
    rest: float = 1.5,
    first_rest: float = 4.0,
    range_share: float = 0.7,
    smoothing: float = 0.012,
) -> Plan:
    """Return random moves and standstills that fill `seconds`.

    Each target is the best of a dozen drawn from the middle `range_share` of the joints' ranges: the one with
    the largest rotation about the axes, and the largest change of gravity along the axes, that had least so far.

    Raises
    ------
    RobotError
        If the arm can hardly move within its ranges.
    """
    low, high = _ranges(arm, range_share)
    planner = Planner(arm, home(arm), first_rest, limits, smoothing)
    seen = np.zeros(6)
    while planner.seconds < seconds:
        q, before = planner.angles, planner.seconds
        target = _best_target(rng, arm, q, low, high, seen)
        planner.go(Move(target, float(rest * rng.uniform(0.8, 1.2)), float(rng.uniform(0.7, 1.0))))
        seen += _excitation(arm, q, target)
        if (took := planner.seconds - before) > seconds:
            raise RobotError(f"a single move takes {took:.0f} s, longer than the recording of {seconds:.0f} s")
    return planner.plan()


def _ranges(arm: Arm, share: float) -> tuple[Array, Array]:
    low, high = np.maximum(arm.lower, -_MAX_HALF_RANGE), np.minimum(arm.upper, _MAX_HALF_RANGE)
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    return middle - half, middle + half


def _best_target(rng: np.random.Generator, arm: Arm, q: Array, low: Array, high: Array, seen: Array) -> Array:
    best, score, tried = q, -np.inf, 0
    while tried < _CANDIDATES or (score == -np.inf and tried < _MANY):
        target, tried = rng.uniform(low, high), tried + 1
        if not _clear(arm, target):
            continue
        after = seen + _excitation(arm, q, target)
        worth = float(np.min(after / np.maximum(seen.mean(), 1.0)) + 0.1 * np.mean(after - seen))
        if worth > score:
            best, score = target, worth
    if score == -np.inf:
        raise RobotError(f"{arm.name}: no pose found clear of base and floor; give a program of poses instead")
    return best


def _clear(arm: Arm, q: Array) -> bool:
    """Return whether the tool is well above the floor and away from the base's axis. Links are not checked."""
    position, _ = kinematics.poses(arm, q[None])
    far = float(np.linalg.norm(position[0]))
    return bool(position[0, 2] > 0.1 * far and np.hypot(*position[0, :2]) > 0.3 * far)


def _excitation(arm: Arm, q: Array, target: Array) -> Array:
    """Return how much a move rotates about each axis of the tool, and changes gravity along it, (6,)."""
    _, quaternions = kinematics.poses(arm, np.linspace(q, target, 5))
    turns = np.abs(log(multiply(conjugate(quaternions[:-1]), quaternions[1:]))).sum(axis=0)
    down = matrix(quaternions)[:, 2, :]
    return np.concatenate([turns, np.abs(np.diff(down, axis=0)).sum(axis=0)])

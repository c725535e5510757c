"""Motion from rest to rest: joint moves with limited velocity, acceleration and jerk, timed by ruckig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array, lengths
from kreisel.robot import kinematics
from kreisel.robot.cubics import Piecewise
from kreisel.robot.description import Arm
from kreisel.robot.kinematics import check_range


@dataclass(frozen=True)
class Limits:
    """Limits of a move: joint velocity, acceleration and jerk (joints,), tool speed and acceleration.

    `straight` moves are straight in joint angles, as those of Universal Robots; in others the joints begin and end
    together, each with an acceleration of its own.
    """

    velocity: Array
    acceleration: Array
    jerk: Array
    tool_speed: float
    tool_acceleration: float
    straight: bool = False

    @classmethod
    def of(cls, arm: Arm, tool_speed: float, tool_acceleration: float) -> Limits:
        """Return usual limits: full speed within half a second, full acceleration within 0.15 s."""
        velocity = arm.velocity.copy()
        return cls(velocity, velocity / 0.5, velocity / 0.5 / 0.15, tool_speed, tool_acceleration)

    def slower(self, share: float) -> Limits:
        """Return the limits for motion that takes 1 / share times as long."""
        return replace(
            self,
            velocity=self.velocity * share,
            acceleration=self.acceleration * share**2,
            jerk=self.jerk * share**3,
        )


@dataclass(frozen=True)
class Move:
    """A joint move to `target` (joints,), rad, and a rest in s there; `speed` is a share of the limits."""

    target: Array
    rest: float
    speed: float = 1.0


@dataclass(frozen=True)
class Timeline:
    """When a motion standstills.

    Attributes
    ----------
    standstills : (k, 2)
        Begin and end of every rest, s; the first begins, and the last ends, with the motion.
    smoothing
        Time over which the motion's set points are averaged, s.
    """

    standstills: Array
    smoothing: float

    @property
    def seconds(self) -> float:
        """Length of the motion, s."""
        return float(self.standstills[-1, 1])

    def at_rest(self, t: Array, margin: float = 0.0) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return whether times (n,) lie in a rest, `margin` or more from its ends."""
        k = np.clip(np.searchsorted(self.standstills[:, 0], t, side="right") - 1, 0, len(self.standstills) - 1)
        begin, end = self.standstills[k].T
        begin = np.where(k == 0, -np.inf, begin + margin)
        end = np.where(k == len(self.standstills) - 1, np.inf, end - margin)
        return np.asarray((t >= begin) & (t <= end))


@dataclass(frozen=True)
class Plan(Timeline):
    """Joint angles over time: one piecewise cubic for each joint."""

    joints: tuple[Piecewise, ...]

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return angles, rates and accelerations (n, joints) of the joints at times (n,)."""
        t = np.clip(t, 0.0, self.seconds)
        if self.smoothing == 0.0:
            rates = [c.derivative() for c in self.joints]
            changes = [c.derivative() for c in rates]
            q, dq, ddq = (np.column_stack([c(t) for c in one]) for one in (self.joints, rates, changes))
            return q, dq, ddq
        half = 0.5 * self.smoothing
        parts: list[list[Array]] = [[], [], []]
        for c in self.joints:
            # The mean over a window: of a function, the difference of its integral.
            for i, f in enumerate((c.antiderivative(), c, c.derivative())):
                parts[i].append((f(t + half) - f(t - half)) / self.smoothing)
        # Differences have rounding noise at standstill.
        q, dq, ddq = (np.column_stack(part) for part in parts)
        still = self.at_rest(t, half)
        q[still] = np.column_stack([c(t[still]) for c in self.joints])
        dq[still] = ddq[still] = 0.0
        return q, dq, ddq


def plan(
    arm: Arm,
    start: Array,
    first_rest: float,
    moves: Sequence[Move],
    limits: Limits,
    smoothing: float = 0.012,
) -> Plan:
    """Return the timed motion through all moves.

    Raises
    ------
    RobotError
        If a target is beyond a joint's range; names the move, the joint and the limit.
    """
    planner = Planner(arm, start, first_rest, limits, smoothing)
    for number, move in enumerate(moves, start=1):
        try:
            planner.go(move)
        except RobotError as error:
            raise RobotError(f"move {number}: {error}") from error
    return planner.plan()


class Planner:
    """Puts moves one after another; each starts where the last one ended.

    Parameters
    ----------
    start, first_rest
        Joint angles (joints,), rad, and the rest there, s.
    smoothing
        Time over which the controller averages its set points, s; no rest is shorter.
    """

    def __init__(self, arm: Arm, start: Array, first_rest: float, limits: Limits, smoothing: float) -> None:
        check_range(arm, start)
        self._arm, self._limits, self._smoothing = arm, limits, smoothing
        self._motion = _Cubics(start, first_rest)

    @property
    def seconds(self) -> float:
        """Length so far, s."""
        return self._motion.time

    @property
    def angles(self) -> Array:
        """Joint angles of the arm at the end, (joints,)."""
        return self._motion.at.copy()

    def go(self, move: Move) -> None:
        """Add a move and its rest; raise RobotError if the target is beyond a joint's range."""
        check_range(self._arm, move.target)
        if np.any(np.abs(move.target - self._motion.at) > 1e-9):
            self._motion.move(_timed(self._arm, self._motion.at, move, self._limits))
        self._motion.rest(max(move.rest, self._smoothing))

    def plan(self) -> Plan:
        """Return the motion."""
        return self._motion.plan(self._smoothing)


def _timed(arm: Arm, q: Array, move: Move, limits: Limits) -> Any:
    """Return ruckig's trajectory, slowed down where the tool would exceed its own limits."""
    share = move.speed
    for _ in range(6):
        trajectory = _ruckig(q, move.target, limits.slower(share))
        speed, acceleration = _tool_peaks(arm, trajectory)
        over = max(
            speed / (limits.tool_speed * move.speed), np.sqrt(acceleration / (limits.tool_acceleration * move.speed**2))
        )
        if over <= 1.0:
            break
        share *= 0.99 / over
    return trajectory


def _ruckig(start: Array, target: Array, limits: Limits) -> Any:
    try:
        from ruckig import InputParameter, Result, Ruckig, Synchronization, Trajectory
    except ImportError as error:
        raise RobotError("planning motion needs ruckig: pip install ruckig, which compiles it") from error
    n = start.size
    given, trajectory = InputParameter(n), Trajectory(n)
    given.current_position, given.target_position = start.tolist(), target.tolist()
    given.max_velocity, given.max_acceleration = limits.velocity.tolist(), limits.acceleration.tolist()
    given.max_jerk = limits.jerk.tolist()
    if limits.straight:
        given.synchronization = Synchronization.Phase
    result = Ruckig(n).calculate(given, trajectory)
    if result not in (Result.Working, Result.Finished):
        raise RobotError(f"no motion found from {np.degrees(start).round(1)} to {np.degrees(target).round(1)} deg")
    return trajectory


def _tool_peaks(arm: Arm, trajectory: Any) -> tuple[float, float]:
    """Return the largest speed and acceleration of the tool, at forty moments of the move."""
    samples = np.array([trajectory.at_time(t) for t in np.linspace(0.0, trajectory.duration, 40)])
    tool = kinematics.motion(arm, samples[:, 0], samples[:, 1], samples[:, 2])
    return (
        float(lengths(tool.velocities).max()),
        float(lengths(tool.accelerations).max()),
    )


class _Cubics:
    """Collects the cubics of every joint, move after move."""

    def __init__(self, start: Array, first_rest: float) -> None:
        self.time = 0.0
        self._rests: list[tuple[float, float]] = []
        self.at = np.array(start, dtype=float)
        self._breaks: list[list[float]] = [[0.0] for _ in start]
        self._cubics: list[list[tuple[float, float, float, float]]] = [[] for _ in start]
        self.rest(first_rest)

    def rest(self, seconds: float) -> None:
        for joint, angle in enumerate(self.at):
            self._append(joint, seconds, (0.0, 0.0, 0.0, float(angle)))
        if self._rests and self._rests[-1][1] == self.time:
            self._rests[-1] = (self._rests[-1][0], self.time + seconds)
        else:
            self._rests.append((self.time, self.time + seconds))
        self.time += seconds

    def move(self, trajectory: Any) -> None:
        for joint, profile in enumerate(trajectory.profiles[0]):
            done = 0.0
            for t, j, a, v, p in zip(profile.t, profile.j, profile.a, profile.v, profile.p, strict=False):
                if t > 0.0:
                    self._append(joint, t, (j / 6.0, a / 2.0, v, p))
                    done += t
            if trajectory.duration - done > 1e-12:
                self._append(joint, trajectory.duration - done, (0.0, 0.0, 0.0, float(profile.pf)))
            self.at[joint] = profile.pf
        self.time += trajectory.duration

    def _append(self, joint: int, seconds: float, cubic: tuple[float, float, float, float]) -> None:
        self._cubics[joint].append(cubic)
        self._breaks[joint].append(self._breaks[joint][-1] + seconds)

    def plan(self, smoothing: float) -> Plan:
        joints = tuple(
            Piecewise(np.array(breaks), np.array(cubics))
            for cubics, breaks in zip(self._cubics, self._breaks, strict=True)
        )
        return Plan(np.array(self._rests), smoothing, joints)

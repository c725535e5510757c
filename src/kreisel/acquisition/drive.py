"""Driving a program: one move at a time, each only once the arm rests, and a stop wherever something is wrong."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable

import numpy as np

from kreisel.acquisition.movers import Mover
from kreisel.devices.events import Arrival, Event, Level
from kreisel.errors import DeviceError
from kreisel.geometry.rotation import Array
from kreisel.protocols import ImuSample, RobotSample
from kreisel.robot.kinematics import Arm
from kreisel.robot.motion import Move
from kreisel.robot.program import Program

NEAR = 3e-3
"""rad; an arm that stands so near its target has arrived."""

STILL = 2e-4
"""rad; an arm whose joints stay within this for `SETTLED` s rests."""

SETTLED = 0.3
MARGIN = math.radians(1.0)
"""rad; an arm that comes so near a limit of its joints is stopped."""

_SATURATED = 20


class Watch:
    """What is seen of arm and IMU while they move; a reason to stop, once there is one.

    Attributes
    ----------
    alarm
        Why to stop, or None.
    """

    def __init__(self, arm: Arm) -> None:
        self.alarm: str | None = None
        self._arm = arm
        self._recent: deque[tuple[int, tuple[float, ...]]] = deque()
        self._same = [0] * 6
        self._last: tuple[float, ...] | None = None

    def take(self, event: Event) -> None:
        """Take what a device brings."""
        if not isinstance(event, Arrival):
            if event.level is Level.LOST:
                self.alarm = self.alarm or event.text
        elif isinstance(event.sample, ImuSample):
            self._imu(event.sample)
        elif event.sample.joints:
            self._robot(event.sample)

    def rests_at(self, target: Array) -> bool:
        """Return whether the arm rests at a target."""
        if not self._recent or self._recent[-1][0] - self._recent[0][0] < SETTLED * 0.9e9:
            return False
        angles = np.array([joints for _, joints in self._recent])
        return bool(np.all(np.ptp(angles, axis=0) < STILL) and np.all(np.abs(angles[-1] - target) < NEAR))

    @property
    def ready(self) -> bool:
        """Whether both devices have been heard."""
        return self._last is not None and bool(self._recent)

    @property
    def joints(self) -> Array | None:
        """The latest joint angles."""
        return np.array(self._recent[-1][1]) if self._recent else None

    def _robot(self, sample: RobotSample) -> None:
        self._recent.append((sample.stamp_ns, sample.joints))
        while self._recent[0][0] < sample.stamp_ns - SETTLED * 1e9:
            self._recent.popleft()
        for name, angle, low, high in zip(
            self._arm.joints, sample.joints, self._arm.lower, self._arm.upper, strict=False
        ):
            if not low + MARGIN < angle < high - MARGIN:
                self.alarm = self.alarm or (
                    f"{name} stands at {math.degrees(angle):.1f} deg, within a degree of its limits "
                    f"{math.degrees(low):.0f} to {math.degrees(high):.0f} deg"
                )

    def _imu(self, sample: ImuSample) -> None:
        """Look for a channel at its limit: it stays the same while others go on."""
        values = (*sample.rate, *sample.acceleration)
        if self._last is not None:
            moving = sum(a != b for a, b in zip(values, self._last, strict=True)) >= 3
            for k, (a, b) in enumerate(zip(values, self._last, strict=True)):
                self._same[k] = self._same[k] + 1 if moving and a == b and a != 0.0 else 0
                if self._same[k] >= _SATURATED:
                    name = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")[k]
                    self.alarm = self.alarm or f"the IMU is saturated: {name} stays at {a:.6g} while the others go on"
        self._last = values


async def drive(
    program: Program,
    mover: Mover,
    watch: Watch,
    stop: asyncio.Event,
    say: Callable[[str], None],
    enough: Callable[[], bool] = lambda: False,
) -> str:
    """Move through a program, and return how it ended: ``done``, ``enough``, or ``stopped: …``.

    The motion is stopped when the watch gives an alarm, when told to stop, and when this is cancelled.

    Parameters
    ----------
    enough
        Whether what was wanted is known; asked between moves.
    """
    try:
        moves = [Move(program.start, 1.0, min(move.speed for move in program.moves)), *program.moves]
        for number, move in enumerate(moves):
            if enough():
                return "enough"
            say(f"move {number} of {len(program.moves)}: {mover.describe(move.target, move.speed)}")
            try:
                await mover.move(move.target, move.speed)
            except DeviceError as error:
                return f"stopped: {error}{await _stopped(mover)}"
            ended = await _until(lambda target=move.target: watch.rests_at(target), watch, stop, _longest(move, watch))  # type: ignore[misc]
            ended = ended or await _until(lambda: False, watch, stop, move.rest, late_is_well=True)
            if ended:
                return f"stopped: {ended}{await _stopped(mover)}"
    except asyncio.CancelledError:
        await _stopped(mover)
        raise
    return "done"


async def _stopped(mover: Mover) -> str:
    """Stop the arm; return what to say where that cannot be known."""
    try:
        await mover.stop()
    except DeviceError as error:
        return f"; and the stop was not taken ({error}): SEE THAT THE ARM RESTS"
    return ""


def _longest(move: Move, watch: Watch) -> float:
    """Return the seconds after which a move that has not ended is given up."""
    way = 0.0 if watch.joints is None else float(np.max(np.abs(move.target - watch.joints)))
    return 10.0 + 20.0 * way / move.speed


async def _until(
    done: Callable[[], bool], watch: Watch, stop: asyncio.Event, seconds: float, *, late_is_well: bool = False
) -> str | None:
    """Wait; return why to stop the motion, or None where all is well."""
    ends = asyncio.get_running_loop().time() + seconds
    while not done():
        if watch.alarm is not None:
            return watch.alarm
        if stop.is_set():
            return "told to"
        if asyncio.get_running_loop().time() > ends:
            return None if late_is_well else f"the arm did not come to rest at its target within {seconds:.0f} s"
        await asyncio.sleep(0.01)
    return None

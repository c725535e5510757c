"""Driving a program: one move at a time, each after the arm has come to rest, and a stop if a fault is detected."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from kreisel.acquisition.background import cancel
from kreisel.acquisition.motion_watch import SETTLED, Watch
from kreisel.acquisition.movers import Mover
from kreisel.acquisition.preflight import approach_share
from kreisel.acquisition.stopping import STOPPED, Say, Stop, Underway, bring_to_rest
from kreisel.errors import DeviceError
from kreisel.geometry.rotation import Array
from kreisel.robot.motion import Move
from kreisel.robot.program import Program

_TICK = 0.01
"""s between two checks for a reason to stop. Chosen: about the interval of the controllers' poses (2 to 12 ms), and far
below the times after which the watch stops the arm (`motion_watch.OVERDUE`)."""

STRAY = math.radians(2.0)
"""rad; largest distance of a joint from its path, or from its rest position, that is not a fault."""

_BENT = math.radians(15.0)
"""rad; the same distance from a path that is not straight in joint angles: axes that begin and end together, each with
an acceleration of its own. Chosen: axes of equal limits stay within a few degrees."""

_STANDING = 3.0
"""s to wait after a rest for joints and IMU to stand, and the controller to hold no program."""

_FOREIGN = 2.0
"""s after arrival in which the controller must have ended the move's program. Chosen: it does within milliseconds."""


@dataclass(frozen=True)
class Ending:
    """How a motion ended.

    Attributes
    ----------
    outcome
        `done`, `enough` if the wanted accuracy is reached, or `stopped`.
    reason
        Why the motion was stopped.
    stop
        The result of the stop.
    """

    outcome: Literal["done", "enough", "stopped"]
    reason: str = ""
    stop: Stop | None = None

    def __str__(self) -> str:
        if self.stop is None:
            return self.outcome
        if not self.stop.confirmed:
            return f"stop NOT confirmed: {self.reason}"
        return f"{'stopped' if self.stop.did == STOPPED else self.stop.did}: {self.reason}"


async def drive(
    program: Program,
    mover: Mover,
    watch: Watch,
    stop: asyncio.Event,
    say: Say,
    enough: Callable[[], bool] = lambda: False,
    *,
    slow: float | None = None,
) -> Ending:
    """Drive the arm through a program, at the speeds of its moves, and return how it ended; see `clearance.slowed`.

    The motion is stopped when the watch or the mover reports a reason, when `stop` is set, and when this function fails
    or is cancelled.

    Parameters
    ----------
    enough
        Returns whether the wanted accuracy is reached; called between moves.
    slow
        Share of full speed of the move to the start, if it is not to be `preflight.approach_share`.
    """
    drive_run = _Drive(program, mover, watch, stop, say)
    try:
        reason = await drive_run.go(enough, slow or approach_share(program, mover))
    except BaseException:
        await bring_to_rest(mover, watch, drive_run.underway, lambda _: None)
        raise
    if reason is None:
        return Ending("enough" if drive_run.enough else "done")
    say(f"the arm is being stopped: {reason}")
    return Ending("stopped", reason, await bring_to_rest(mover, watch, drive_run.underway, say))


class _Drive:
    """The state of a drive through a program: the move under way."""

    def __init__(self, program: Program, mover: Mover, watch: Watch, stop: asyncio.Event, say: Say) -> None:
        self.underway: Underway | None = None
        self.enough = False
        self._resting: Array | None = None
        self._progress, self._told_loose = 0.0, False
        self._held_since: float | None = None
        self._beside = STRAY if mover.straight else _BENT
        self._program, self._mover, self._watch, self._stop, self._say = program, mover, watch, stop, say

    async def go(self, enough: Callable[[], bool], slow: float) -> str | None:
        """Make all moves, the first at its own speed; return a reason to stop, or None."""
        moves = [Move(self._program.start, 1.0, slow), *self._program.moves]
        for number, move in enumerate(moves):
            if enough():
                self.enough = True
                return None
            ended = await self._one(number, move)
            if ended is not None:
                return ended
        return None

    async def _one(self, number: int, move: Move) -> str | None:
        """Make a move and rest; return a reason to stop, or None."""
        await asyncio.sleep(_TICK)  # so that the end of a connection is detected before the move
        why = self._why() or ("another program runs on the controller" if self._watch.holds else None)
        if why is not None:
            return why
        described = self._mover.describe(move.target, move.speed)
        self._say(f"move {number} of {len(self._program.moves)}: {described}")
        seconds = _longest(move, self._watch)
        self.underway, self._resting, self._progress = Underway(move.target, self._watch.joints), None, 0.0
        self._watch.begin_move(self._peaks(move))
        if (why := await unless(self._mover.move(move.target, move.speed), self._why)) is not None:
            return why
        ended = await self._until(lambda: self._watch.rests_at(move.target) and not self._holds_on(), seconds)
        if ended is None:
            self.underway, self._resting = None, move.target
            self._watch.rest()
            ended = await self._until(lambda: False, move.rest, late_is_well=True)
            if ended is None:
                ended = await self._until(self._stands, _STANDING)
        if ended is None:
            self._watch.rotation.learn_offset(SETTLED)
            if self._watch.rotation.loose and not self._told_loose:
                self._told_loose = True
                self._say("the IMU does not turn with the arm: is it mounted? The joints alone are watched")
        return ended

    def _stands(self) -> bool:
        """Whether the arm has stood for a while, and the controller holds no program."""
        return not self._watch.holds and self._watch.stands(0, SETTLED)

    def _peaks(self, move: Move) -> Array | None:
        """Return the largest speeds of the joints in a move, rad/s; None if it is not known where the arm is."""
        at = self._watch.joints
        if at is None or not np.any(move.target != at):
            return None
        return self._mover.peaks(move.target - at, move.speed, self._watch.arm.velocity)[0]

    def _holds_on(self) -> bool:
        """Whether the controller goes on with a program; see `_FOREIGN`."""
        loop = asyncio.get_running_loop()
        if not self._watch.holds:
            self._held_since = None
            return False
        self._held_since = self._held_since or loop.time()
        if loop.time() - self._held_since > _FOREIGN:
            self._watch.alarm = (
                self._watch.alarm or "the controller goes on with a program although the arm has arrived"
            )
        return True

    def _why(self) -> str | None:
        """Return a reason to stop now, or None."""
        if self._watch.reason is not None:
            return self._watch.reason
        if self._mover.trouble is not None:
            return self._mover.trouble
        if self._strays():
            return "the arm moves during a rest" if self._resting is not None else "the arm leaves its path"
        return "stop requested" if self._stop.is_set() else None

    def _strays(self) -> bool:
        """Return whether a joint is outside the range of its move, or away from its rest position."""
        joints = self._watch.joints
        if joints is None:
            return False
        if self._resting is not None:
            return bool(np.any(np.abs(joints - self._resting) > STRAY))
        if self.underway is None or self.underway.start is None:
            return False
        start, way = self.underway.start, self.underway.target - self.underway.start
        length = float(way @ way)
        share = float(np.clip((joints - start) @ way / length, 0.0, 1.0)) if length > 0.0 else 0.0
        self._progress = max(self._progress, share)
        beside = np.abs(joints - (start + share * way))
        back = (self._progress - share) * float(np.max(np.abs(way)))
        return bool(np.any(beside > self._beside) or back > STRAY)

    async def _until(self, done: Callable[[], bool], seconds: float, *, late_is_well: bool = False) -> str | None:
        """Wait until `done` or a timeout; return a reason to stop the motion, or None."""
        ends = asyncio.get_running_loop().time() + seconds
        while True:
            if (why := self._why()) is not None:
                return why
            if done():
                return None
            if self.underway is not None and self._watch.ended():
                if self._watch.paused:
                    return "the controller has paused the move"
                excuse = self._mover.excuse
                return f"the controller has ended the move away from its target{f': {excuse}' if excuse else ''}"
            if asyncio.get_running_loop().time() > ends:
                return None if late_is_well else f"the arm did not come to rest at its target within {seconds:.0f} s"
            await asyncio.sleep(_TICK)


async def unless(action: Coroutine[Any, Any, None], why: Callable[[], str | None]) -> str | None:
    """Run an action until there is a reason to stop; return that reason, or the action's error, or None."""
    task = asyncio.ensure_future(action)
    try:
        while not task.done():
            if (reason := why()) is not None:
                return reason
            await asyncio.wait([task], timeout=_TICK)
        task.result()
    except DeviceError as error:
        return str(error)
    finally:
        await cancel(task)
    return None


def _longest(move: Move, watch: Watch) -> float:
    """Return the seconds after which a move that has not ended is a fault."""
    longest = 0.0 if watch.joints is None else float(np.max(np.abs(move.target - watch.joints)))
    return 10.0 + 20.0 * longest / move.speed

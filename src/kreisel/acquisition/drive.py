"""Driving a program: one move at a time, each only once the arm rests, and a stop wherever something is wrong."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from kreisel.acquisition.arming import CHECKED, approach_share
from kreisel.acquisition.halting import Say, Stop, Underway, bring_to_rest
from kreisel.acquisition.movers import Mover
from kreisel.acquisition.watch import Watch
from kreisel.errors import DeviceError
from kreisel.geometry.rotation import Array
from kreisel.robot.motion import Move
from kreisel.robot.program import Program

_TICK = 0.01

STRAY = math.radians(2.0)
"""rad; joints that are farther from their way, or from where they are to rest, are moved by somebody else."""


@dataclass(frozen=True)
class Ending:
    """How a motion ended.

    Attributes
    ----------
    outcome
        `done`, `enough` where what was wanted is known, or `stopped`.
    reason
        Why it was stopped.
    stop
        How that went.
    """

    outcome: Literal["done", "enough", "stopped"]
    reason: str = ""
    stop: Stop | None = None

    def __str__(self) -> str:
        if self.stop is None:
            return self.outcome
        return f"stopped: {self.reason}" if self.stop.confirmed else f"stop NOT confirmed: {self.reason}"


async def drive(
    program: Program,
    mover: Mover,
    watch: Watch,
    stop: asyncio.Event,
    say: Say,
    enough: Callable[[], bool] = lambda: False,
) -> Ending:
    """Move through a program, and return how it ended.

    The motion is stopped when the watch or the mover reports a reason, when told to stop, and when this fails or is
    cancelled.

    Parameters
    ----------
    enough
        Whether what was wanted is known; asked between moves.
    """
    way = _Way(program, mover, watch, stop, say)
    try:
        reason = await way.go(enough)
    except BaseException:
        await bring_to_rest(mover, watch, way.underway, lambda _: None)
        raise
    if reason is None:
        return Ending("enough" if way.enough else "done")
    say(f"the arm is being stopped: {reason}")
    return Ending("stopped", reason, await bring_to_rest(mover, watch, way.underway, say))


class _Way:
    """The way through a program: which move is under way."""

    def __init__(self, program: Program, mover: Mover, watch: Watch, stop: asyncio.Event, say: Say) -> None:
        self.underway: Underway | None = None
        self.enough = False
        self._resting: Array | None = None
        self._program, self._mover, self._watch, self._stop, self._say = program, mover, watch, stop, say

    async def go(self, enough: Callable[[], bool]) -> str | None:
        """Make all moves; return why to stop, or None."""
        slow = approach_share(self._program, self._mover)
        moves = [Move(self._program.start, 1.0, slow), *self._program.moves]
        for number, move in enumerate(moves):
            if enough():
                self.enough = True
                return None
            speed = min(move.speed, slow) if number <= CHECKED else move.speed
            ended = await self._one(number, Move(move.target, move.rest, speed))
            if ended is not None:
                return ended
        return None

    async def _one(self, number: int, move: Move) -> str | None:
        """Make a move and rest; return why to stop, or None."""
        await asyncio.sleep(_TICK)  # so that a connection that has ended by now is known to have
        if (why := self._why()) is not None:
            return why
        described = self._mover.describe(move.target, move.speed)
        self._say(f"move {number} of {len(self._program.moves)}: {described}")
        seconds = _longest(move, self._watch)
        self.underway, self._resting = Underway(move.target, self._watch.joints), None
        self._watch.begin_move()
        if (why := await unless(self._mover.move(move.target, move.speed), self._why)) is not None:
            return why
        ended = await self._until(lambda: self._watch.rests_at(move.target), seconds)
        if ended is None:
            self.underway, self._resting = None, move.target
            ended = await self._until(lambda: False, move.rest, late_is_well=True)
        return ended

    def _why(self) -> str | None:
        """Return why to stop now, or None."""
        if self._watch.reason is not None:
            return self._watch.reason
        if self._mover.trouble is not None:
            return self._mover.trouble
        if self._strays():
            return "the arm moves while it is to rest" if self._resting is not None else "the arm leaves its way"
        return "told to" if self._stop.is_set() else None

    def _strays(self) -> bool:
        """Return whether a joint is not between the ends of its move, or not where it is to rest."""
        joints = self._watch.joints
        if joints is None:
            return False
        if self._resting is not None:
            return bool(np.any(np.abs(joints - self._resting) > STRAY))
        if self.underway is None or self.underway.start is None:
            return False
        low = np.minimum(self.underway.start, self.underway.target) - STRAY
        high = np.maximum(self.underway.start, self.underway.target) + STRAY
        return bool(np.any((joints < low) | (joints > high)))

    async def _until(self, done: Callable[[], bool], seconds: float, *, late_is_well: bool = False) -> str | None:
        """Wait; return why to stop the motion, or None where all is well."""
        ends = asyncio.get_running_loop().time() + seconds
        while True:
            if (why := self._why()) is not None:
                return why
            if done():
                return None
            if self.underway is not None and self._watch.ended():
                return "the controller has ended the move away from its target"
            if asyncio.get_running_loop().time() > ends:
                return None if late_is_well else f"the arm did not come to rest at its target within {seconds:.0f} s"
            await asyncio.sleep(_TICK)


async def unless(action: Coroutine[Any, Any, None], why: Callable[[], str | None]) -> str | None:
    """Do something unless there is a reason to stop meanwhile; return that reason, or what failed, or None."""
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
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    return None


def _longest(move: Move, watch: Watch) -> float:
    """Return the seconds after which a move that has not ended is given up."""
    way = 0.0 if watch.joints is None else float(np.max(np.abs(move.target - watch.joints)))
    return 10.0 + 20.0 * way / move.speed

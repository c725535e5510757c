"""Stopping an arm: each way to stop in turn, until the reported joints stand still."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol

from kreisel.acquisition.motion_watch import Watch
from kreisel.errors import DeviceError
from kreisel.geometry.rotation import Array

SETTLE_TIME = 0.5
"""Seconds that the joints must stand still before a stop is confirmed."""

SETTLE_TIME_BEFORE_MOVES = 2.0
"""The same if a move was sent and the arm has not visibly begun it: it may still begin."""

_WAY = 0.8
"""s to wait for a standstill after one way to stop; then the next way follows. Chosen: braking besides `SETTLE_TIME`,
and no longer, because the arm may still move."""

_BLIND = 0.1
"""s to wait in place of `_WAY` if no joint angles are received: nothing can confirm the stop. Chosen: two intervals of
the slowest source, 20 poses a second."""

_LAST = 0.5
"""s to wait, besides the duration of the standstill, after all ways. Chosen: time to brake after the last of them."""

_ROUNDS = 2
"""Times that all ways are taken; after the first the user is asked to press the emergency stop. Chosen: one repetition
for a connection that failed for a moment; more would delay the report."""

_TICK = 0.02  # s between two checks; chosen: a few poses, and a small part of `_BLIND`
_BEGUN = 1e-2  # rad; an arm that has moved farther since a move was sent has begun it

STOPPED = "the motion was stopped"
"""What became of a motion that a stop ended."""

LATE = "the move was completed before the stop"
"""What became of a motion that a stop did not end: it had no effect, or came too late."""

UNCLEAR = "the arm stands, whether stopped or at the end of its move"
"""What became of a motion whose joints the IMU has contradicted."""

_BRAKING = 0.25
"""s after which an arm that was told to stop is visibly slower; otherwise the next way follows at once."""

_MOVING = 0.05  # rad/s from which a joint's speed is compared

_SLOWER = 0.8
"""Share of its speed above which an arm does not brake."""

Say = Callable[[str], None]
Way = tuple[str, Callable[[], Awaitable[None]]]
"""A way to stop: its description and its action, which raises DeviceError if it fails."""


class Stoppable(Protocol):
    """An object with ways to stop an arm."""

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways to stop, the quickest first."""


@dataclass(frozen=True)
class Underway:
    """A move that was sent: its target, and the joint angles when it was sent, rad."""

    target: Array
    start: Array | None


@dataclass(frozen=True)
class Stop:
    """The result of a stop.

    Attributes
    ----------
    confirmed
        Whether the joints are known to stand still.
    text
        What was done and observed.
    did
        What became of the motion, where it is confirmed.
    """

    confirmed: bool
    text: str
    did: str = STOPPED


async def bring_to_rest(mover: Stoppable, watch: Watch, underway: Underway | None, say: Say) -> Stop:
    """Stop the arm by each way in turn until its joints stand still, and return the result.

    Parameters
    ----------
    underway
        The move that was sent; None if there is none.
    """
    since = watch.now_ns
    seconds = SETTLE_TIME_BEFORE_MOVES if _may_begin(underway, watch) else SETTLE_TIME
    done: list[str] = []
    taken = False
    for number in range(_ROUNDS):
        for name, way in _in_order(mover.ways, watch):
            try:
                await way()
            except DeviceError as error:
                done.append(f"{name}: failed ({error})")
                continue
            taken = True
            done.append(f"{name}: sent")
            if await _standing(watch, since, seconds, _WAY):
                return _confirmed(done, seconds, watch, underway)
        if await _standing(watch, since, seconds, seconds + _LAST):
            if taken or underway is None or watch.rests_at(underway.target):
                return _confirmed(done, seconds, watch, underway)
            return Stop(False, f"the joints stand still now, but no stop could be sent ({'; '.join(done)})")
        if number == 0:
            say("THE STOP IS NOT CONFIRMED: press the emergency stop; trying again")
    return Stop(False, f"{_blind(watch)} ({'; '.join(done)})")


def _in_order(ways: tuple[Way, ...], watch: Watch) -> tuple[Way, ...]:
    """Return the ways in their order; where joints are not trusted, the last comes second: it needs no answer."""
    return ways if watch.rotation.complaint is None else (ways[0], *reversed(ways[1:]))


def _confirmed(done: list[str], seconds: float, watch: Watch, underway: Underway | None) -> Stop:
    seen = "and the IMU does not turn" if watch.witness else "by the joints alone: the IMU does not tell"
    text = f"the joints have stood still for {seconds:g} s, {seen} ({'; '.join(done) or 'no move was under way'})"
    if watch.rotation.complaint is not None:
        text = f"the IMU has not turned for {seconds:g} s; the joints contradicted it, and tell neither where nor why"
        return Stop(True, f"{text} ({'; '.join(done)})", UNCLEAR)
    if underway is not None and watch.rests_at(underway.target):
        return Stop(True, f"{text}; the arm stands at the target of its move: it was not stopped on its way", LATE)
    return Stop(True, text)


def _blind(watch: Watch) -> str:
    if watch.holds and watch.stands(watch.now_ns - round(2e9 * SETTLE_TIME), SETTLE_TIME):
        return "the joints stand still now, but the controller still holds a program and may continue it"
    if not watch.hears():
        return "no joint angles are received"
    return watch.motion or "the joints still move"


def _may_begin(underway: Underway | None, watch: Watch) -> bool:
    """Return whether a move was sent and the arm has not visibly begun it."""
    joints = watch.joints
    if underway is None:
        return False
    if underway.start is None or joints is None:
        return True
    return bool(abs(joints - underway.start).max() < _BEGUN) and not watch.rests_at(underway.target)


async def _standing(watch: Watch, since_ns: int, seconds: float, patience: float) -> bool:
    """Wait until the controller holds no program and the joints stand still; return whether that was observed.

    The wait is short if no joint angles are received.
    """
    loop = asyncio.get_running_loop()
    ends = loop.time() + patience
    looks, fast = loop.time() + _BRAKING, watch.speed
    blind_ends = loop.time() + (_BLIND if patience == _WAY else patience)
    while watch.holds or not watch.stands(since_ns, seconds):
        if patience == _WAY and loop.time() > looks and fast > _MOVING and watch.speed > _SLOWER * fast:
            return False
        if loop.time() > (ends if watch.hears() else blind_ends):
            return False
        await asyncio.sleep(_TICK)
    return True

"""Bringing an arm to rest: every way in turn, until its joints are seen to stand."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol

from kreisel.acquisition.watch import Watch
from kreisel.errors import DeviceError
from kreisel.geometry.rotation import Array

STANDS = 0.5
"""Seconds that joints stand still before a stop is confirmed."""

STANDS_LONG = 2.0
"""The same where a move was sent and the arm has not been seen to begin it: it may still do so."""

_WAY = 0.8
_BLIND = 0.1
_LAST = 0.5
_ROUNDS = 2
_TICK = 0.02
_BEGUN = 1e-2  # rad; an arm that moved so far from where a move was sent has begun it

Say = Callable[[str], None]
Way = tuple[str, Callable[[], Awaitable[None]]]
"""A way to stop in words, and what does it; it raises DeviceError where it fails."""


class Stoppable(Protocol):
    """What can be asked to stop."""

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways to stop, the quickest first."""


@dataclass(frozen=True)
class Underway:
    """A move that was sent: where to, and where the joints were, rad."""

    target: Array
    start: Array | None


@dataclass(frozen=True)
class Stop:
    """How a stop went.

    Attributes
    ----------
    confirmed
        Whether the joints were seen to stand.
    text
        What was done and seen.
    """

    confirmed: bool
    text: str


async def bring_to_rest(mover: Stoppable, watch: Watch, underway: Underway | None, say: Say) -> Stop:
    """Stop the arm by every way in turn until its joints stand, and return how that went.

    Parameters
    ----------
    underway
        The move the arm was sent on, None where there is none.
    """
    since = watch.now_ns
    seconds = STANDS_LONG if _may_begin(underway, watch) else STANDS
    done: list[str] = []
    taken = False
    for number in range(_ROUNDS):
        for name, way in mover.ways:
            try:
                await way()
            except DeviceError as error:
                done.append(f"{name}: failed ({error})")
                continue
            taken = True
            done.append(f"{name}: sent")
            if await _seen(watch, since, seconds, _WAY):
                return _confirmed(done, seconds)
        if await _seen(watch, since, seconds, seconds + _LAST):
            if taken or underway is None or watch.rests_at(underway.target):
                return _confirmed(done, seconds)
            return Stop(False, f"the joints stand now, but no stop could be sent ({'; '.join(done)})")
        if number == 0:
            say("THE STOP IS NOT CONFIRMED: press the emergency stop; trying again")
    return Stop(False, f"{_blind(watch)} ({'; '.join(done)})")


def _confirmed(done: list[str], seconds: float) -> Stop:
    return Stop(True, f"the joints have stood still for {seconds:g} s ({'; '.join(done) or 'no move was under way'})")


def _blind(watch: Watch) -> str:
    if watch.holds and watch.stands(watch.now_ns - round(2e9 * STANDS), STANDS):
        return "the joints stand now, but the controller still holds a program and may go on with it"
    return "the joints still move" if watch.hears() else "no joint angles come in"


def _may_begin(underway: Underway | None, watch: Watch) -> bool:
    """Return whether the arm was sent somewhere and has not been seen to move yet."""
    joints = watch.joints
    if underway is None:
        return False
    if underway.start is None or joints is None:
        return True
    return bool(abs(joints - underway.start).max() < _BEGUN) and not watch.rests_at(underway.target)


async def _seen(watch: Watch, since_ns: int, seconds: float, patience: float) -> bool:
    """Wait until the controller holds no program and the joints stand; return whether that was seen.

    Without joint angles the wait is short.
    """
    loop = asyncio.get_running_loop()
    ends = loop.time() + patience
    blind_ends = loop.time() + (_BLIND if patience == _WAY else patience)
    while watch.holds or not watch.stands(since_ns, seconds):
        if loop.time() > (ends if watch.hears() else blind_ends):
            return False
        await asyncio.sleep(_TICK)
    return True

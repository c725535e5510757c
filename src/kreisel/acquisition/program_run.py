"""Recording and driving at the same time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.acquisition.clearance import Room, approach
from kreisel.acquisition.drive import Ending, drive, unless
from kreisel.acquisition.motion_watch import Watch
from kreisel.acquisition.movers import Mover
from kreisel.acquisition.preflight import Allowed, check_state
from kreisel.acquisition.recorder import Status, record
from kreisel.acquisition.stopping import SETTLE_TIME, Say
from kreisel.devices.address import Address
from kreisel.devices.opening import events
from kreisel.errors import DeviceError, RecordingError
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.robot.description import Arm
from kreisel.robot.program import Program

_PATIENCE = 10.0
"""s to wait for readings of both devices before the first move. Chosen: time for a second attempt to connect, after the
5 s of the first (`devices.drivers`); nothing moves meanwhile."""

_STANDING = 3.0
"""s to wait for the arm to stand before the first move. Chosen: several times `stopping.SETTLE_TIME`."""


@dataclass(frozen=True)
class Devices:
    """Addresses of IMU and robot, and the mover."""

    imu: Address
    robot: Address
    mover: Mover


@dataclass(frozen=True)
class Orders:
    """The task: the program, the arm, and the limits set by the user.

    Attributes
    ----------
    enough
        Returns whether the wanted accuracy is reached; called between moves.
    """

    program: Program
    arm: Arm
    allowed: Allowed
    enough: Callable[[], bool]
    room: Room


async def run(
    orders: Orders,
    devices: Devices,
    output: Path,
    settings: RecordingSettings,
    halt: asyncio.Event,
    say: Say,
) -> tuple[Ending, Status]:
    """Drive a program while the cell is recorded; return how the motion ended, and what was recorded.

    See `drive` and `record`. Nothing is moved before the arm's pose is known and checked; see `check_state`.

    Raises
    ------
    DeviceError, RobotError
        If a device cannot be reached, or a check before the first move fails.
    RecordingError
        If the file cannot be written; the motion is then stopped.
    """
    over, mover, allowed = asyncio.Event(), devices.mover, orders.allowed
    watch = Watch(orders.arm, overdue=allowed.silence, tool_speed=allowed.tool_speed)
    recording = asyncio.ensure_future(
        record(
            devices.imu, devices.robot, output, settings=settings, urdf=orders.arm.urdf, stop=over, observe=watch.take
        )
    )
    watching = asyncio.ensure_future(_watch_on(recording, devices, watch))
    try:
        slow = await _begin(orders, mover, watch, halt, say)
        ending = await drive(orders.program, mover, watch, halt, say, orders.enough, slow=slow)
    finally:
        await mover.close()
        watching.cancel()
        over.set()
        await asyncio.wait([recording, watching])
        failure = recording.exception()
        if failure is not None and not isinstance(failure, RecordingError):
            raise failure
    if isinstance(failure, RecordingError):
        raise RecordingError(f"{failure.message}{_how(ending)}", file=failure.file) from failure
    return ending, recording.result()


def _how(ending: Ending) -> str:
    """Return a text on how the motion ended, for an error of the recorder."""
    if ending.stop is None:
        return f"; the motion ended: {ending}"
    if ending.stop.confirmed:
        return f"; {ending.stop.did}: {ending.stop.text}"
    return f"; THE STOP IS NOT CONFIRMED: press the emergency stop; {ending.stop.text}"


async def _watch_on(recording: asyncio.Future[Status], devices: Devices, watch: Watch) -> None:
    """Stop the motion if the recorder fails, and continue to read joints and IMU, to confirm the stop."""
    await asyncio.wait([recording])
    watch.alarm = watch.alarm or f"the recorder has ended: {recording.exception() or 'no more data'}"

    async def read_on(address: Address) -> None:
        with suppress(DeviceError):
            async for event in events(address):
                watch.take(event)

    await asyncio.gather(read_on(devices.robot), read_on(devices.imu))


async def _begin(orders: Orders, mover: Mover, watch: Watch, halt: asyncio.Event, say: Say) -> float | None:
    """Wait for the devices, check their reports, and connect the mover; return the speed of the move to the start."""

    def why() -> str | None:
        return watch.reason or ("stop requested" if halt.is_set() else None)

    await _until_seen(watch, halt)
    if watch.holds:
        raise DeviceError(
            "nothing was moved: the controller runs another program, or has paused one; end it there, and begin again"
        )
    await _until_standing(watch, why)
    watch.rotation.learn_offset(SETTLE_TIME)
    slow = None
    if watch.sample is not None:
        for text in check_state(orders.arm, orders.program, watch.sample, mover, orders.allowed):
            say(text)
        joints = np.array(watch.sample.joints)
        slow = approach(orders.arm, orders.program, mover, joints, orders.room, orders.allowed.tool_speed)
    if (reason := await unless(mover.connect(), why)) is not None:
        raise DeviceError(f"nothing was moved: {reason}")
    say(mover.guard)
    if not watch.tells_programs:
        say("the controller does not report whether it runs a program: a stop cannot be distinguished from a pause")
    return slow


async def _until_standing(watch: Watch, why: Callable[[], str | None]) -> None:
    """Wait until joints and IMU have not moved for a while.

    Raises
    ------
    DeviceError
        If they move: somebody else drives the arm.
    """
    loop, begun = asyncio.get_running_loop(), watch.now_ns
    ends = loop.time() + _STANDING
    while not watch.stands(begun, SETTLE_TIME):
        if (reason := why()) is not None:
            raise DeviceError(f"nothing was moved: {reason}")
        if loop.time() > ends:
            raise DeviceError(
                f"nothing was moved: {watch.motion or 'the joints move'}, and the arm must stand before it is driven"
            )
        await asyncio.sleep(0.01)


async def _until_seen(watch: Watch, halt: asyncio.Event) -> None:
    """Wait for the arm's joint angles and the IMU's readings."""
    ends = asyncio.get_running_loop().time() + _PATIENCE
    while not watch.ready or watch.reason is not None:
        if halt.is_set() or watch.reason is not None or asyncio.get_running_loop().time() > ends:
            raise DeviceError(f"nothing was moved: {watch.reason or 'robot and IMU do not both send data'}")
        await asyncio.sleep(0.01)

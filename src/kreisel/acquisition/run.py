"""Recording and driving side by side."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from kreisel.acquisition.drive import Watch, drive
from kreisel.acquisition.movers import Mover
from kreisel.acquisition.record import Status, record
from kreisel.devices.address import Address
from kreisel.errors import DeviceError
from kreisel.recording.settings import RecordingSettings
from kreisel.robot.kinematics import Arm
from kreisel.robot.program import Program

_PATIENCE = 10.0


async def run(
    program: Program,
    arm: Arm,
    mover: Mover,
    imu: Address,
    robot: Address,
    output: Path,
    settings: RecordingSettings,
    halt: asyncio.Event,
    say: Callable[[str], None],
    enough: Callable[[], bool],
) -> tuple[str, Status]:
    """Drive a program while the cell is recorded; return how the motion ended, and what was recorded.

    See `drive` and `record`. Nothing is moved before the arm's pose is known.

    Raises
    ------
    DeviceError
        If a device cannot be reached.
    RecordingError
        If the file cannot be written; the motion is stopped then.
    """
    over, watch = asyncio.Event(), Watch(arm)
    recording = asyncio.ensure_future(
        record(imu, robot, output, settings=settings, urdf=arm.urdf, stop=over, observe=watch.take)
    )
    recording.add_done_callback(lambda _: halt.set())  # a recorder that fails stops the motion
    try:
        await _until_seen(watch, halt)
        await mover.connect()
        ended = await drive(program, mover, watch, halt, say, enough)
    finally:
        await mover.close()
        over.set()
        await asyncio.wait([recording])
    return ended, recording.result()


async def _until_seen(watch: Watch, halt: asyncio.Event) -> None:
    """Wait for the arm's joint angles and the IMU's readings."""
    ends = asyncio.get_running_loop().time() + _PATIENCE
    while not watch.ready:
        if halt.is_set() or watch.alarm is not None or asyncio.get_running_loop().time() > ends:
            raise DeviceError(f"nothing was moved: {watch.alarm or 'robot and IMU do not both tell what they measure'}")
        await asyncio.sleep(0.01)

"""`kreisel run`: drive a program, record, and stop when enough is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli.watch import DASHBOARD, PORT, page_of

if TYPE_CHECKING:
    from kreisel.acquisition.movers import Mover
    from kreisel.acquisition.record import Status
    from kreisel.devices.address import Address
    from kreisel.recording.settings import RecordingSettings
    from kreisel.robot.kinematics import Arm
    from kreisel.robot.program import Program


def run_program(
    program: Path = typer.Argument(..., help="A program of moves (`kreisel simulate --example-program` prints one)."),
    robot: str = typer.Option(
        ..., "--robot", help="Where the arm tells its pose and joint angles, as for `kreisel record`."
    ),
    imu: str = typer.Option(..., "--imu", help="Address of the IMU, as for `kreisel record`."),
    mover: str | None = typer.Option(
        None,
        "--mover",
        help="Where moves are sent: urscript://HOST, ekrl://HOST or serial:///dev/…; the same host for rtde and ekrl.",
    ),
    model: str = typer.Option(..., "--model", help="The robot: kr125, ur10e, or a .urdf file."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Recording: an .mcap file, or a folder to make."),
    arm: bool = typer.Option(False, "--arm", help="Really move the robot. Without, what would be sent is printed."),
    speed: float = typer.Option(1.0, min=0.05, max=3.2, help="Speed of the leading joint at full share, rad/s."),
    until: list[str] = typer.Option(
        [],
        "--until",
        help="End once a standard deviation is small enough: accelerometer.offset=0.02mg; may be repeated.",
    ),
    settings: Path | None = typer.Option(None, help="recording.toml with what is known of IMU, site and reference."),
    seconds: float = typer.Option(3600.0, min=1.0, help="Give up after so long."),
    dashboard: bool = DASHBOARD,
    port: int = PORT,
) -> None:
    """Move a robot through a program, one move at a time, while the IMU is recorded and calibrated.

    The motion is stopped when a device is lost, the IMU is saturated, a joint comes near its limit, or you interrupt.
    """
    from kreisel.acquisition.movers import mover_at
    from kreisel.devices.address import IMUS, MOVERS, ROBOTS, default_mover, parse_address
    from kreisel.errors import DeviceError, SettingsError
    from kreisel.recording.settings import RecordingSettings, read_settings
    from kreisel.robot.kinematics import load_arm
    from kreisel.robot.program import read_program

    of_imu, of_robot = parse_address(imu, IMUS), parse_address(robot, ROBOTS)
    mover = mover or default_mover(of_robot)
    if mover is None:
        known = "; ".join(scheme.example for scheme in MOVERS.values())
        raise SettingsError(f"{robot} only tells where the arm is; say with --mover where moves are sent: {known}")
    of_mover = parse_address(mover, MOVERS)
    if of_imu.scheme == "mcap":
        raise SettingsError(f"{imu}: a recording feels nothing of this motion; give the address of the IMU itself")
    targets = dict(_target(text) for text in until)
    described = load_arm(model)
    moves = read_program(program, described)
    sender = mover_at(of_mover, speed, float(described.velocity.max()))
    if not arm:
        _show_dry(moves, sender)
        return
    if output is None:
        raise SettingsError("where to? `-o RECORDING` names a folder or an .mcap file")
    recorded = RecordingSettings() if settings is None else read_settings(settings)
    with page_of(output, port, wanted=dashboard):
        ended, status = _drive(moves, described, sender, of_imu, of_robot, output, recorded, targets, seconds)
    typer.echo(
        f"{output}: {status.seconds:.1f} s, {status.imu.count} IMU samples, {status.robot.count} poses; {ended}; "
        f"next: kreisel calibrate {output} -o OUT"
    )
    if ended.startswith("stopped"):
        raise DeviceError(f"the motion was {ended}; what was recorded is kept in {output}")


_UNITS = {"mg": 9.80665e-3, "deg/h": 4.84814e-6, "ppm": 1e-6, "mm": 1e-3, "ms": 1e-3, "": 1.0}


def _target(text: str) -> tuple[str, float]:
    """Return group and standard deviation, SI, of a target such as ``accelerometer.offset=0.02mg``."""
    import re

    from kreisel.errors import SettingsError

    match = re.fullmatch(r"([a-z_.]+)\s*=\s*([0-9.eE+-]+)\s*([a-z/]*)", text.strip())
    if match is None or match.group(3) not in _UNITS:
        units = ", ".join(unit for unit in _UNITS if unit)
        raise SettingsError(f"--until '{text}' is not GROUP=NUMBER and a unit ({units}), or none for SI")
    try:
        return match.group(1), float(match.group(2)) * _UNITS[match.group(3)]
    except ValueError as error:
        raise SettingsError(f"--until '{text}': '{match.group(2)}' is no number") from error


def _show_dry(moves: Program, mover: Mover) -> None:
    typer.echo("nothing is moved (add --arm to move the robot); this would be sent, each once the arm rests:")
    typer.echo(f"  0  {mover.describe(moves.start, min(move.speed for move in moves.moves))}")
    for number, move in enumerate(moves.moves, start=1):
        typer.echo(f"{number:3d}  {mover.describe(move.target, move.speed)}   then rest {move.rest:g} s")


def _drive(
    moves: Program, known: Arm, mover: Mover, imu: Address, robot: Address, output: Path,
    recorded: RecordingSettings, targets: dict[str, float], seconds: float,
) -> tuple[str, Status]:  # fmt: skip
    """Record and drive until the program ends, enough is known, or it is time to stop."""
    import asyncio
    import signal
    import threading

    from kreisel.acquisition.run import run
    from kreisel.dashboard.online import Targets

    reached = Targets(output, targets, lambda text: typer.echo(text, err=True))
    threading.Thread(target=reached.look, daemon=True).start()

    async def both() -> tuple[str, Status]:
        halt = asyncio.Event()
        loop = asyncio.get_running_loop()
        for name in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(name, halt.set)
        loop.call_later(seconds, halt.set)
        say = lambda text: typer.echo(text, err=True)  # noqa: E731
        return await run(moves, known, mover, imu, robot, output, recorded, halt, say, lambda: reached.reached)

    try:
        return asyncio.run(both())
    finally:
        reached.over = True

"""`kreisel run`: run a program, record, and stop when the calibration is accurate enough."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion
from kreisel.cli.watch import DASHBOARD, PORT, page_of

if TYPE_CHECKING:
    from kreisel.acquisition.drive import Ending
    from kreisel.acquisition.movers import Mover
    from kreisel.acquisition.program_run import Devices, Orders
    from kreisel.acquisition.recorder import Status
    from kreisel.dashboard.online import Targets
    from kreisel.recording.recording_settings import RecordingSettings
    from kreisel.robot.program import Program


JOINT_SPEED = 1.0
"""rad/s of the leading joint at full share, by default. Chosen: half the limit of a usual arm."""

TOOL_SPEED = 0.25
"""m/s; the tool is not moved faster unless stated otherwise. It is the limit of ISO 10218-1 for manual operation at
reduced speed."""


def run_program(
    program: Path = typer.Argument(..., help="A program of moves (`kreisel simulate --example-program` prints one)."),
    robot: str = typer.Option(
        ...,
        "--robot",
        help="Where the arm reports its pose and joint angles, as for `kreisel record`.",
        autocompletion=completion.robots,
    ),
    imu: str = typer.Option(
        ..., "--imu", help="Address of the IMU, as for `kreisel record`.", autocompletion=completion.imus
    ),
    mover: str | None = typer.Option(
        None,
        "--mover",
        help="Where moves are sent: urscript://HOST, ekrl://HOST or serial:///dev/…; the same host for rtde and ekrl.",
        autocompletion=completion.movers,
    ),
    model: str = typer.Option(
        ..., "--model", help="The robot: kr125, ur10e, or a .urdf file.", autocompletion=completion.arms
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Recording: an .mcap file, or a folder to make."),
    arm: bool = typer.Option(False, "--arm", help="Move the robot. Without it, only print what would be sent."),
    speed: float = typer.Option(
        JOINT_SPEED, min=0.05, max=3.2, help="Speed of the leading joint at full share, rad/s."
    ),
    approach: float = typer.Option(
        10.0, min=0.0, max=720.0, help="Largest distance of a joint from the program's start for the move to it, deg."
    ),
    longest_tool: float = typer.Option(
        0.3, min=0.0, help="Longest tool that may explain the difference of the reported pose to the model's, m (rtde)."
    ),
    tool_speed: float = typer.Option(
        TOOL_SPEED,
        "--tool-speed",
        min=0.01,
        max=10.0,
        help="Fastest speed of the tool, m/s; moves are slowed down to it.",
    ),
    floor: float = typer.Option(
        0.0, min=-100.0, max=100.0, help="Height of the floor in the base's frame, m; nothing may be below it."
    ),
    keep_out: list[str] = typer.Option(
        [], "--keep-out", help="Box that the arm must not enter, two corners x,y,z,x,y,z in m; may be repeated."
    ),
    silence: float = typer.Option(
        0.2, min=0.05, max=5.0, help="Seconds without joint angles or readings after which the arm is stopped."
    ),
    until: list[str] = typer.Option(
        [],
        "--until",
        help="End when a standard deviation is small enough: accelerometer.offset=0.02mg; may be repeated.",
        autocompletion=completion.accuracies,
    ),
    settings: Path | None = typer.Option(None, help="recording.toml with what is known of IMU, site and reference."),
    seconds: float = typer.Option(3600.0, min=1.0, help="End after this many seconds."),
    picture: Path | None = typer.Option(None, "--picture", help="Page to write with the path of the arm, .html."),
    dashboard: bool = DASHBOARD,
    port: int = PORT,
) -> None:
    """Move a robot through a program, one move at a time, while the IMU is recorded and calibrated.

    The motion is stopped when a device is silent, the IMU is saturated or contradicts the joints, the arm is faster
    than commanded or leaves its path, the controller reports a stop or ends the connection, or you interrupt. A stop is
    confirmed if the joints stand still and the IMU does not turn.
    """
    import math

    from kreisel.acquisition.clearance import Room, check_room, parse_box, slowed
    from kreisel.acquisition.driver_lock import only_driver
    from kreisel.acquisition.limits_used import COLUMNS, limits_used, row_of
    from kreisel.acquisition.movers import mover_at
    from kreisel.acquisition.preflight import Allowed, check_program
    from kreisel.acquisition.program_run import Devices, Orders
    from kreisel.cli.targets import targets
    from kreisel.cli.terminal_tables import print_rows
    from kreisel.devices.address import IMUS, MOVERS, ROBOTS, check_sender, default_mover, parse_address, with_rtde_of
    from kreisel.errors import SettingsError
    from kreisel.recording.recording_settings import RecordingSettings, read_settings
    from kreisel.report.path_page import write_path
    from kreisel.robot.kinematics import load_arm
    from kreisel.robot.program import read_program

    of_imu, of_robot = parse_address(imu, IMUS), parse_address(robot, ROBOTS)
    check_sender(of_robot)
    mover = mover or default_mover(of_robot)
    if mover is None:
        known = "; ".join(scheme.example for scheme in MOVERS.values())
        raise SettingsError(f"{robot} only reports where the arm is; give with --mover where moves are sent: {known}")
    of_mover = with_rtde_of(parse_address(mover, MOVERS), of_robot)
    if of_imu.scheme == "mcap":
        raise SettingsError(f"{imu}: a recording does not measure this motion; give the address of the IMU itself")
    wanted = targets(until)
    described = load_arm(model)
    sender = mover_at(of_mover, speed, float(described.velocity.max()))
    room = Room(floor, tuple(parse_box(box) for box in keep_out))
    written = read_program(program, described)
    checked = [check_program(described, written, sender), check_room(described, written, room)]
    moves, slower = slowed(described, written, sender, tool_speed)
    checked.append(slower)
    rows = [row_of(use) for use in limits_used(described, moves, sender, room, tool_speed)]
    if picture is not None:
        write_path(described, moves, room.floor, room.boxes, COLUMNS, rows, checked, picture)
    if not arm:
        _show_dry(moves, sender, checked)
        print_rows("limits, and what the program uses of them", COLUMNS, rows, text=1)
        return
    if output is None:
        raise SettingsError("no output is given; `-o RECORDING` names a folder or an .mcap file")
    recorded = RecordingSettings() if settings is None else read_settings(settings)
    longest = longest_tool if of_robot.scheme == "rtde" else None
    allowed = Allowed(math.radians(approach), longest, tool_speed, silence)
    reached = _targets(output, wanted)
    orders = Orders(moves, described, allowed, lambda: reached.reached, room)
    for text in checked:
        _say(text)
    try:
        with only_driver(of_mover), page_of(output, port, wanted=dashboard):
            ended, status = _drive(orders, Devices(of_imu, of_robot, sender), output, recorded, seconds)
    finally:
        reached.over = True
        _terminal.say("").wait(_PATIENCE)
    _say_end(output, ended, status)


def _say_end(output: Path, ended: Ending, status: Status) -> None:
    """Report how the motion ended.

    Raises
    ------
    DeviceError
        If it was stopped, or its stop is not confirmed.
    """
    from kreisel.errors import DeviceError

    typer.echo(
        f"{output}: {status.seconds:.1f} s, {status.imu.count} IMU samples, {status.robot.count} poses; {ended}; "
        f"next: kreisel calibrate {output} -o OUT"
    )
    if ended.stop is None:
        return
    kept = f"what was recorded is kept in {output}"
    if ended.stop.confirmed:
        raise DeviceError(f"{ended.stop.did}: {ended.reason}; {kept}; {ended.stop.text}")
    raise DeviceError(
        f"THE STOP IS NOT CONFIRMED: press the emergency stop; {ended.stop.text}; it was asked for because: "
        f"{ended.reason}; {kept}"
    )


_JOIN = 60.0
"""Seconds to wait for the end of the check of the targets."""


def _show_dry(moves: Program, mover: Mover, checked: list[str]) -> None:
    from kreisel.acquisition.preflight import approach_share
    from kreisel.cli.terminal_tables import print_sentences

    slow = approach_share(moves, mover)
    typer.echo("nothing is moved (add --arm to move the robot); this would be sent, each once the arm rests:")
    typer.echo(f"  0  {mover.describe(moves.start, slow)}")
    for number, move in enumerate(moves.moves, start=1):
        typer.echo(f"{number:3d}  {mover.describe(move.target, move.speed)}   then rest {move.rest:g} s")
    later = (
        "checked only with --arm, before the first move: the way to the program's start, against the room too, and the "
        "model against the joints and the pose that the controller reports"
    )
    print_sentences([*checked, later])


_PATIENCE = 1.0
"""s to wait for a terminal at the end. Chosen: one that takes nothing for so long is blocked."""


class _Terminal:
    """Writes reports in a thread of its own: a terminal that is blocked or closed must not keep the arm from a stop."""

    def __init__(self) -> None:
        from queue import SimpleQueue

        self._texts: SimpleQueue[tuple[str, threading.Event]] = SimpleQueue()
        self._begun = False

    def say(self, text: str) -> threading.Event:
        """Report progress; return an event that is set once it is written."""
        if not self._begun:
            self._begun = True
            threading.Thread(target=self._write, name="terminal", daemon=True).start()
        written = threading.Event()
        self._texts.put((text, written))
        return written

    def _write(self) -> None:
        while True:
            text, written = self._texts.get()
            if text:
                with suppress(OSError):
                    typer.echo(text, err=True)
            written.set()


_terminal = _Terminal()


def _say(text: str) -> None:
    """Report progress, without waiting for the terminal."""
    _terminal.say(text)


def _targets(output: Path, targets: dict[str, float]) -> Targets:
    """Return the check of the `--until` targets, which runs in its own thread."""
    import atexit

    from kreisel.dashboard.online import Targets

    reached = Targets(output, targets, _say)
    if targets:
        looking = threading.Thread(target=reached.look, daemon=True)
        looking.start()
        atexit.register(looking.join, _JOIN)  # a thread inside the compiler must not outlive the interpreter
    return reached


def _drive(
    orders: Orders, devices: Devices, output: Path, recorded: RecordingSettings, seconds: float
) -> tuple[Ending, Status]:
    """Record and move until the program ends, the targets are reached, or a stop is requested."""
    import asyncio
    import signal

    from kreisel.acquisition.program_run import run

    stops = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)

    async def both() -> tuple[Ending, Status]:
        halt = asyncio.Event()
        loop = asyncio.get_running_loop()

        def stop(name: str) -> None:
            halt.set()
            _say(f"{name}: the arm is to stop")

        for number in stops:
            loop.add_signal_handler(number, stop, number.name)
        loop.call_later(seconds, stop, f"--seconds {seconds:g} have passed")
        return await run(orders, devices, output, recorded, halt, _say)

    try:
        return asyncio.run(both())
    finally:
        for number in stops:  # the arm has stopped; a second signal must not change the outcome
            signal.signal(number, signal.SIG_IGN)

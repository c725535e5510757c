"""`kreisel virtual-cell`: a simulated robot and IMU to record from."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli.run_program import JOINT_SPEED, TOOL_SPEED

if TYPE_CHECKING:
    from kreisel.robot.program import Program
    from kreisel.simulation.cell_settings import Cell


class RobotKind(StrEnum):
    """Controllers that can be simulated."""

    rsi = "rsi"
    rtde = "rtde"
    egm = "egm"
    ekrl = "ekrl"
    varproxy = "varproxy"
    ros2 = "ros2"


class ImuKind(StrEnum):
    """IMUs that can be simulated."""

    ixcom = "ixcom"
    csv = "csv"
    mavlink = "mavlink"
    ros2 = "ros2"


def virtual_cell(
    cell: Path | None = typer.Argument(
        None, help="CELL.toml as for `kreisel simulate`; the default cell if not given."
    ),
    robot: RobotKind = typer.Option(RobotKind.rsi, help="Protocol of the controller."),
    imu: ImuKind = typer.Option(ImuKind.ixcom, help="Protocol of the IMU."),
    interval: float | None = typer.Option(
        None,
        min=0.001,
        max=1.0,
        help="Seconds between two poses; 0.012 (rsi), 0.002 (rtde, ros2), 0.004 (egm, varproxy), 0.024 (ekrl).",
    ),
    seconds: float | None = typer.Option(None, help="Length to use instead of the cell's, s."),
    seed: int | None = typer.Option(None, help="Seed to use instead of the cell's."),
    speed: float = typer.Option(1.0, min=0.1, max=100.0, help="Factor of speed against real time."),
    robot_port: int = typer.Option(
        0, min=0, max=65535, help="Port where the controller sends or listens; any by default."
    ),
    imu_port: int = typer.Option(0, min=0, max=65535, help="Port where the IMU listens; any by default."),
    obey: bool = typer.Option(
        False, "--obey", help="The arm waits at every rest of its program for `kreisel run`; with rtde, rsi or ekrl."
    ),
    joint_speed: float = typer.Option(
        JOINT_SPEED, min=0.05, max=3.2, help="With --obey: the --speed that `kreisel run` is given, rad/s."
    ),
    tool_speed: float = typer.Option(
        TOOL_SPEED,
        "--tool-speed",
        min=0.01,
        max=10.0,
        help="With --obey: the --tool-speed that `kreisel run` is given, m/s.",
    ),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Folder for truth.json, recording.toml and robot.urdf of the cell."
    ),
) -> None:
    """Play a virtual cell over the network, once: the motion begins when a recorder asks the IMU for readings.

    When both devices are ready, one line of JSON gives their addresses: {"robot": URL, "imu": URL}; with --obey also
    the address for moves: "mover".
    """
    import json
    import signal
    import sys

    from kreisel.acquisition.virtual_cell import COMMANDED, commanded, running
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import SettingsError
    from kreisel.formats.write import write_settings
    from kreisel.simulation.cell import simulate, write_truth

    if obey and robot.value not in COMMANDED:
        raise SettingsError(
            f"--obey: a simulated {robot.value} arm does not accept moves; choose {', '.join(COMMANDED)}"
        )
    if obey and (speed != 1.0 or robot_port or imu_port):
        raise SettingsError("--speed, --robot-port and --imu-port are for a cell without --obey")
    described = _described(cell, robot, interval, {"seed": seed, "seconds": seconds})
    if output is not None:
        check_output(output)
    with progress_bar() as show:
        program = _obeyed(described, robot.value, joint_speed, tool_speed) if obey else None
        truth, recording = simulate(described, Path("virtual cell"), show, program=program)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_truth(truth, output / "truth.json")
        write_settings(recording, output)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    cell_of = (
        commanded(recording, robot.value, imu.value)
        if obey
        else running(recording, robot.value, imu.value, speed=speed, robot_port=robot_port, imu_port=imu_port)
    )
    with cell_of as (urls, processes):
        where = {"robot": urls.robot, "imu": urls.imu, "mover": urls.mover}
        typer.echo(json.dumps({name: url for name, url in where.items() if url is not None}))
        sys.stdout.flush()
        try:
            for process in processes:
                process.join()
        except KeyboardInterrupt:
            return


def _obeyed(cell: Cell, robot: str, joint_speed: float, tool_speed: float) -> Program | None:
    """Return the cell's program with the speeds that `kreisel run` commands; None if it has none."""
    from kreisel.acquisition.clearance import as_moved, slowed
    from kreisel.acquisition.movers import mover_at
    from kreisel.acquisition.virtual_cell import COMMANDED
    from kreisel.devices.address import MOVERS, parse_address
    from kreisel.robot.kinematics import load_arm
    from kreisel.robot.program import read_program

    if cell.motion.program is None:
        return None
    arm = load_arm(cell.robot.model, cell.robot.tcp)
    mover = mover_at(parse_address(f"{COMMANDED[robot]}://virtual", MOVERS), joint_speed, float(arm.velocity.max()))
    sent, _ = slowed(arm, read_program(Path(cell.motion.program), arm), mover, tool_speed)
    return as_moved(arm, sent, mover)


def _described(cell: Path | None, robot: RobotKind, interval: float | None, changes: dict[str, float | None]) -> Cell:
    """Return the cell, with the interval of poses given here, in its file, or usual for such controllers."""
    from kreisel.acquisition.virtual_cell import INTERVALS
    from kreisel.errors import SettingsError
    from kreisel.simulation.cell_settings import Cell, parse_cell, read_cell

    known = Cell() if cell is None else read_cell(cell)
    content = known.model_dump()
    reference = content["reference"]
    if interval is not None or "interval" not in known.reference.model_fields_set:
        reference["interval"] = interval or INTERVALS[robot]
    content.update({name: value for name, value in changes.items() if value is not None})
    if robot in (RobotKind.rsi, RobotKind.ekrl):  # whose clocks count whole milliseconds
        cycle = 1e3 * reference["interval"]
        if abs(cycle - round(cycle)) > 1e-9:
            raise SettingsError(
                f"{cycle:g} ms between two poses: a KUKA's cycles are whole milliseconds; see --interval"
            )
        reference["clock_offset"] = round(reference["clock_offset"], 3)
    return parse_cell(content, cell or Path("CELL.toml"))

"""`kreisel record`: record readings of one IMU or several and poses of a robot in one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion
from kreisel.cli.watch import DASHBOARD, PORT, page_of

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Sequence

    from kreisel.acquisition.recorder import Place, Status
    from kreisel.devices.address import Address
    from kreisel.recording.recording_settings import RecordingSettings


def record(
    imu: list[str] = typer.Option(
        ...,
        "--imu",
        help="Address of the IMU, such as ixcom://192.168.1.30:3000, csv://…, mavlink://…, ros2://… or mcap:///FILE; "
        "may be repeated, for units of a tray.",
        autocompletion=completion.imus,
    ),
    robot: str | None = typer.Option(
        None,
        "--robot",
        help="Address of the robot, such as rsi://0.0.0.0:49152, rtde://…, egm://…, varproxy://…, ros2://… or mcap:///FILE.",
        autocompletion=completion.robots,
    ),
    output: Path = typer.Option(..., "-o", "--output", help="Recording: an .mcap file, or a folder to make."),
    seconds: float | None = typer.Option(
        None, "--seconds", min=0.1, help="End this many seconds after readings of all devices have begun."
    ),
    settings: Path | None = typer.Option(None, help="recording.toml with what is known of IMU, site and reference."),
    urdf: Path | None = typer.Option(None, help="The robot's description; needed to use joint angles."),
    dashboard: bool = DASHBOARD,
    port: int = PORT,
) -> None:
    """Record until interrupted; nothing that moves the robot is ever sent."""
    import asyncio
    import sys

    from kreisel.acquisition.recorder import Place
    from kreisel.acquisition.recorder import record as record_streams
    from kreisel.devices.address import IMUS, ROBOTS, parse_address
    from kreisel.recording.recording_settings import RecordingSettings, read_settings

    of_imu, *further = [parse_address(address, IMUS) for address in imu]
    of_robot = None if robot is None else parse_address(robot, ROBOTS)
    known = RecordingSettings() if settings is None else read_settings(settings)
    robot_text = None if urdf is None else description(urdf)

    async def until_stopped() -> Status:
        stop = interrupted()
        return await record_streams(
            of_imu,
            of_robot,
            output,
            further=further,
            seconds=seconds,
            settings=known,
            urdf=robot_text,
            stop=stop,
            show=_show(),
        )

    place = Place.of(output)
    with page_of(output, port, wanted=dashboard):
        status = asyncio.run(until_stopped())
    if sys.stderr.isatty():
        typer.echo(err=True)
    check_complete(status, (of_imu, *further), of_robot, place)
    poses = f", {status.robot.count} poses at {status.robot.rate:.1f} Hz" if robot is not None else ""
    missing, late = (
        f"{', '.join(str(getattr(stream, name)) for stream in status.imus)} and {getattr(status.robot, name)}"
        for name in ("missing", "late")
    )
    typer.echo(
        f"{output}: {status.seconds:.1f} s, {_samples(status)}{poses}; missing {missing}, repeated or late {late}; "
        f"next: kreisel {'static' if robot is None else 'calibrate'} {output} -o OUT"
    )
    for name, seconds_ago in status.silent.items():
        typer.echo(
            f"nothing came from {name} in the last {seconds_ago:.1f} s: the recording ends there for it", err=True
        )
    _check_settings(known, status)


def _samples(status: Status) -> str:
    """Return how many samples there are of each IMU."""
    if not status.further:
        return f"{status.imu.count} IMU samples at {status.imu.rate:.1f} Hz"
    return ", ".join(f"{s.count} samples of imu{k} at {s.rate:.1f} Hz" for k, s in enumerate(status.imus))


def interrupted() -> asyncio.Event:
    """Return an event of the running loop that is set when the program is to end."""
    import asyncio
    import signal

    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        loop.add_signal_handler(name, stop.set)
    return stop


def check_complete(status: Status, imus: Sequence[Address], robot: Address | None, place: Place) -> None:
    """Raise an error if a device sent no readings; those of the other devices are kept in a separate file.

    Raises
    ------
    DeviceError
        With the last message about the device.
    """
    from kreisel.devices.faults import AGAIN
    from kreisel.errors import DeviceError

    if status.complete(with_robot=robot is not None):
        if status.locked_out:
            raise DeviceError(f"{status.locked_out}; what was recorded is kept in {place.file}, and may be of another")
        return
    counts = [(imu, "readings", stream.count) for imu, stream in zip(imus, status.imus, strict=True)]
    if robot is not None:
        counts.append((robot, "poses", status.robot.count))
    missing = [(address, what) for address, what, count in counts if not count]
    messages = []
    for address, what in missing:
        own = f"{address}: "
        notes = [note.removeprefix(own) for note in status.notes if len(counts) == 1 or note.startswith(own)]
        messages.append(f"no {what} came from {address}{f': {notes[-1]}' if notes else ''}".removesuffix(AGAIN))
    kept = "nothing was recorded" if status.empty else place.kept_elsewhere()
    raise DeviceError(f"{'; '.join(messages)}; {kept}")


def _check_settings(known: RecordingSettings, status: Status) -> None:
    """Print what is still missing for a calibration."""
    if known.site.latitude_deg is None and known.site.gravity is None:
        typer.echo(
            "without a latitude gravity is known only to 0.15 %: set it in recording.toml (--settings)", err=True
        )
    missing = status.excitation.missing()
    if missing:
        typer.echo(f"for a calibration the motion lacks: {', '.join(missing)}", err=True)


def description(path: Path) -> str:
    """Return the text of a robot's description.

    Raises
    ------
    SettingsError
        If it cannot be read.
    """
    from kreisel.errors import SettingsError
    from kreisel.files import read_text

    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read as a robot's description: {error}") from error


def _show() -> Callable[[Status], None]:
    """Return a function that prints new notes and, on a terminal, a status line that it overwrites."""
    import sys

    printed = 0

    def show(status: Status) -> None:
        nonlocal printed
        for note in status.notes[printed:]:
            typer.echo(f"\r{note}" + " " * 20, err=True)
        printed = len(status.notes)
        if not sys.stderr.isatty():
            return
        parts = [f"{status.seconds:6.1f} s", f"{status.written / 1e6:.1f} MB"]
        imus = [(f"imu{k}" if status.further else "IMU", stream) for k, stream in enumerate(status.imus)]
        for name, stream in (*imus, ("robot", status.robot)):
            drift = "" if stream.drift_ppm is None else f" {stream.drift_ppm:+.0f} ppm"
            parts.append(f"{name} {stream.rate:.1f} Hz{drift}, {stream.missing} missing")
        parts.append(
            "lacks: " + ", ".join(status.excitation.missing())
            if status.excitation.missing()
            else "motion is sufficient"
        )
        typer.echo("\r" + " | ".join(parts)[:140].ljust(100), nl=False, err=True)

    return show


def recover(
    file: Path = typer.Argument(..., help="An .mcap file that was cut or damaged, or the folder it is in."),
    output: Path | None = typer.Option(None, "-o", "--output", help="The copy; FILE_recovered.mcap by default."),
) -> None:
    """Write a readable copy of a damaged recording next to it, and print what was lost."""
    from kreisel.formats.mcap import RECORDED
    from kreisel.formats.recover import recover as recover_file

    found = recover_file(file / RECORDED if file.is_dir() else file, output)
    counts = ", ".join(f"{count} on {topic}" for topic, count in sorted(found.messages.items()))
    typer.echo(f"{found.path}: {found.seconds:.1f} s, {counts or 'no messages'}")
    typer.echo(f"lost: {found.lost}" if found.lost else "nothing was lost: the file is whole")

"""`kreisel convert`: from one kind of recording to another."""

from __future__ import annotations

from pathlib import Path

import typer

from kreisel.cli import options


def convert(
    source: Path = typer.Argument(..., help="Recording to read, or a KUKA trace (.dat with its .r64, or text)."),
    target: Path = typer.Argument(
        ...,
        help="What to write: a new folder, an .mcap file, or a .tum file of only the poses. "
        "For a trace, a recording folder.",
    ),
    reference: str | None = options.REFERENCE,
    imu: str | None = options.ONE_OR_ALL_IMUS,
    columns: list[str] = options.COLUMNS,
) -> None:
    """Convert a recording: any kind kreisel reads to a folder of CSV, an MCAP file or a TUM trajectory.

    All units of a tray are written, where no IMU is chosen.

    A trace of a KUKA controller ($TRACE) has only the robot's part of a recording: its poses and joint angles are added
    to a folder with the readings of the IMU, or to a new folder to which these are added later.
    """
    from kreisel.formats.kuka_trace import is_trace

    if is_trace(source):
        _convert_trace(source, target, reference or imu)
        return
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.formats.imus import ALL, imu_reader, imus_in
    from kreisel.formats.loading import load
    from kreisel.formats.write import write

    names = imus_in(source, imu) if imu in (None, ALL) and not columns else ()
    chosen = names[0] if len(names) > 1 else imu
    with progress_bar() as show:
        recording = load(source, reference, chosen, columns=columns, progress=show)
    read = imu_reader(source) if len(names) > 1 else None
    write(recording, target, {} if read is None else {name: read(name)[0] for name in names[1:]})
    for warning in recording.warnings:
        typer.echo(f"· {warning}")
    typer.echo(f"written: {target}" + (f", {len(names)} IMUs" if len(names) > 1 else ""))


def _convert_trace(source: Path, target: Path, choice: str | None) -> None:
    from kreisel.errors import RecordingError, SettingsError
    from kreisel.formats.input_formats import SUFFIXES
    from kreisel.formats.kuka_trace import add_trace
    from kreisel.formats.write import WRITERS

    if choice is not None:
        raise SettingsError(f"'{choice}': a trace has no streams to choose from; leave --reference and --imu out")
    if target.suffix.lower() in {*SUFFIXES, *WRITERS}:
        raise RecordingError("a trace is added to a recording folder; give a folder", file=target)
    for warning in add_trace(source, target):
        typer.echo(f"· {warning}")
    typer.echo(f"written: {target}")

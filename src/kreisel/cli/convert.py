"""`kreisel convert`: from one kind of recording to another."""

from __future__ import annotations

from pathlib import Path

import typer


def convert(
    source: Path = typer.Argument(..., help="Recording to read."),
    target: Path = typer.Argument(..., help="Recording to write: a new folder, or a file ending in .mcap."),
    reference: str | None = typer.Option(None, help="Reference: a folder's name, or a topic."),
    imu: str | None = typer.Option(None, help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID)."),
) -> None:
    """Convert a recording: any kind kreisel reads to a folder of CSV or an MCAP file."""
    from kreisel.recording import load
    from kreisel.recording.write import write

    recording = load(source, reference, imu)
    write(recording, target)
    typer.echo(f"written: {target}")

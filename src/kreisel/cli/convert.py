"""`kreisel convert`: from one kind of recording to another."""

from __future__ import annotations

from pathlib import Path

import typer


def convert(
    source: Path = typer.Argument(..., help="Recording to read."),
    target: Path = typer.Argument(
        ..., help="What to write: a new folder, an .mcap file, or a .tum file of the poses alone."
    ),
    reference: str | None = typer.Option(None, help="Reference: a folder's name, or a topic."),
    imu: str | None = typer.Option(None, help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID)."),
) -> None:
    """Convert a recording: any kind kreisel reads to a folder of CSV, an MCAP file or a TUM trajectory."""
    from kreisel.recording import load
    from kreisel.recording.write import write

    recording = load(source, reference, imu)
    write(recording, target)
    typer.echo(f"written: {target}")

"""Options that several commands have: which streams of a recording, and which columns of a table."""

from __future__ import annotations

from typing import Any

import typer

from kreisel.cli import completion

REFERENCE: Any = typer.Option(None, help="Reference: a folder's name, or a topic.", autocompletion=completion.streams)
"""Which reference is used."""

IMU: Any = typer.Option(
    None, help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID).", autocompletion=completion.streams
)
"""Which IMU is used, of a command for one."""

ONE_OR_ALL_IMUS: Any = typer.Option(
    None,
    help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID); all: those on all topics, as one tray.",
    autocompletion=completion.streams,
)
"""Which IMU is used, of a command for one or for a tray."""

COLUMNS: Any = typer.Option(
    [],
    "--map",
    help="Columns of a table of another shape, 'imu.time=t [ms]'; may be repeated.",
    autocompletion=completion.columns,
)
"""What the columns of a table hold."""

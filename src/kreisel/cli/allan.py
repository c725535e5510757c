"""`kreisel allan`: noise figures of readings at rest."""

from __future__ import annotations

from pathlib import Path

import typer


def allan(
    recording: Path = typer.Argument(..., help="Recording at rest: a folder, a table, an .mcap file, or a ROS bag."),
    imu: str | None = typer.Option(None, help="IMU: a folder's name, or a topic (TOPIC@FRAME_ID)."),
    columns: list[str] = typer.Option(
        [], "--map", help="Columns of a table of another shape, 'imu.time=t [ms]'; may be repeated."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for allan.html and allan.json."),
    json: bool = typer.Option(False, "--json", help="Print the figures as one JSON object."),
) -> None:
    """Print the noise figures that the overlapping Allan deviation of readings at rest shows, with deviations.

    White noise, bias instability, random walk, quantisation and rate ramp; "-" (null) where the length shows none.
    """
    import json as json_module

    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.terminal_tables import print_rows
    from kreisel.formats.loading import load
    from kreisel.preparation.resting_noise import allan_report, document_of, settings_of
    from kreisel.report.allan_page import COLUMNS, rows_of, write_allan

    if output is not None:
        check_output(output)
    with progress_bar() as show:
        found = allan_report(load(recording, imu=imu, columns=columns, progress=show))
    document = document_of(found)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_allan(recording.resolve().name, found, output / "allan.html")
        (output / "allan.json").write_text(json_module.dumps(document, indent=1) + "\n", encoding="utf-8")
    if json:
        typer.echo(json_module.dumps(document))
        return
    print_rows(f"noise figures of {found.seconds:.0f} s at rest", COLUMNS, rows_of(found))
    for remark in found.remarks:
        typer.echo(f"· {remark}")
    typer.echo(f"for recording.toml:\n{settings_of(found)}")
    if output is not None:
        typer.echo(f"written: {output / 'allan.html'}, allan.json")

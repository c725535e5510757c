"""`kreisel array`: where the IMUs of an array lie, from a recording without a reference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from kreisel.array.array_outcome import ArrayOutcome


def array(
    recording: Path = typer.Argument(
        ..., help="Recording: a folder with imu0, imu1, …, an .mcap file or a ROS bag; no poses."
    ),
    imu: str | None = typer.Option(None, help="all: those on all topics of a bag that kreisel did not write."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for array.yaml and report.html."),
    json: bool = typer.Option(False, "--json", help="Print array.yaml's content as one JSON object."),
) -> None:
    """Locate the IMUs of a rigid array that was moved by hand.

    Turn the array into ten attitudes or more and hold it still in each, then shake it about all axes for half a minute.
    With poses of a robot or of cameras, `kreisel calibrate` finds the same, and calibrates all units.
    """
    import json as as_json
    from dataclasses import replace

    from kreisel.array.unit_readings import first_readable, unit_reader
    from kreisel.array.without_reference import locate
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import RecordingError
    from kreisel.formats.imus import imus_in
    from kreisel.formats.loading import load

    if output is not None:
        check_output(output)
    names = imus_in(recording, imu)
    if len(names) < 2:
        load(recording, imu=names[0] if names else None)
        raise RecordingError(
            "has one IMU; an array is a folder with imu0, imu1, …, or a bag with several topics",
            file=recording,
        )
    unread: dict[str, str] = {}
    with progress_bar() as show:
        base, readable = first_readable(lambda name: load(recording, imu=name), recording, names, unread)
        outcome = locate(unit_reader(base, readable[0]), readable, show)
        outcome = replace(outcome, left_out=(*unread.items(), *outcome.left_out))
    if output is not None:
        _write(outcome, output)
    if json:
        document = outcome.document if output is None else {**outcome.document, "output": str(output)}
        typer.echo(as_json.dumps(document))
        return
    _say(outcome, output)


def _write(outcome: ArrayOutcome, output: Path) -> None:
    from kreisel.calibration.result import write_document
    from kreisel.files import replaced_together
    from kreisel.report.array_page import write_array

    with replaced_together(output, ("array.yaml", "report.html")) as writing:
        write_document(outcome.document, writing / "array.yaml")
        write_array(outcome, writing / "report.html")


def _say(outcome: ArrayOutcome, output: Path | None) -> None:
    from kreisel.cli.terminal_tables import print_rows, print_sentences
    from kreisel.report.array_page import COLUMNS, facts_of, unit_rows
    from kreisel.report.places import POSE_COLUMNS, pose_rows

    print_rows(f"{outcome.recording.name}: units", list(COLUMNS), unit_rows(outcome), 2)
    print_rows(f"places in the axes of {outcome.reference}", list(POSE_COLUMNS), pose_rows(outcome.poses), 1)
    print_sentences(facts_of(outcome))
    written = f"written: {output}/array.yaml, report.html"
    typer.echo(written if output is not None else "nothing written; -o OUT writes array.yaml and a report")

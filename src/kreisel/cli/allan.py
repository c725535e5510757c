"""`kreisel allan`: noise figures of readings at rest, or in motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.cli import options

if TYPE_CHECKING:
    from kreisel.calibration.motion_noise import MotionNoise
    from kreisel.progress import Progress
    from kreisel.recording.recording import Recording


def allan(
    recording: Path = typer.Argument(..., help="Recording: a folder, a table, an .mcap file, or a ROS bag."),
    imu: str | None = options.IMU,
    columns: list[str] = options.COLUMNS,
    in_motion: bool = typer.Option(
        False, "--in-motion", help="Of a recording with poses: what a filter needs in motion, beside the noise at rest."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for allan.html and allan.json."),
    json: bool = typer.Option(False, "--json", help="Print the figures as one JSON object."),
) -> None:
    """Print the noise figures of readings at rest, by their overlapping Allan deviation, or of readings in motion.

    At rest: white noise, bias instability, random walk, quantisation and rate ramp, with deviations; "-" (null) where
    the length shows none. In motion the recording is calibrated first, and the likeliest densities are judged on data
    that had no part in them.
    """
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.formats.loading import load
    from kreisel.inertial.noise_figures import settings_table
    from kreisel.preparation.resting_noise import allan_report, document_of
    from kreisel.report.allan_page import COLUMNS, rows_of, write_allan

    if output is not None:
        check_output(output)
    if in_motion:
        with progress_bar() as show:
            moving = _moving(load(recording, imu=imu, columns=columns, progress=show), show)
        _show_moving(recording, moving, output, json=json)
        return
    with progress_bar() as show:
        found = allan_report(load(recording, imu=imu, columns=columns, progress=show))
    document = document_of(found)
    if output is not None:
        _write(document, output)
        write_allan(recording.resolve().name, found, output / "allan.html")
    title = f"noise figures of {found.seconds:.0f} s at rest"
    table = settings_table(document["filter"])
    _show(title, COLUMNS, rows_of(found), found.remarks, table, document, output, json=json)


def _moving(recording: Recording, show: Progress | None) -> MotionNoise:
    """Return the noise in motion of a recording that is calibrated for it."""
    from kreisel.calibration.calibrate import run_calibration
    from kreisel.calibration.motion_noise import motion_noise
    from kreisel.errors import RecordingError
    from kreisel.model.calibration_settings import CalibrationSettings

    if recording.reference is None:
        raise RecordingError(
            "has no poses, by which a filter in motion is judged; without --in-motion the noise at rest is found",
            file=recording.imu.source,
        )
    outcome = run_calibration(recording, CalibrationSettings(), show)
    if not outcome.verdict.accepted:
        raise RecordingError(
            f"the calibration by which noise in motion is found is rejected: {outcome.verdict.reasons[0]}",
            file=recording.imu.source,
        )
    return motion_noise(outcome, show)


def _show_moving(recording: Path, found: MotionNoise, output: Path | None, *, json: bool) -> None:
    from kreisel.inertial.noise_figures import settings_table
    from kreisel.report.motion_noise_page import COLUMNS, remarks_of, rows_of, write_motion_noise

    remarks = remarks_of(found)
    document = found.document | {"remarks": remarks}
    if output is not None:
        _write(document, output)
        write_motion_noise(recording.resolve().name, found, output / "allan.html")
    title = "noise in motion, over noise at rest"
    table = settings_table(found.figures)
    _show(title, COLUMNS, rows_of(found), remarks, table, document, output, json=json)


def _write(document: dict[str, Any], output: Path) -> None:
    import json as json_module

    from kreisel.files import write_whole

    write_whole(output / "allan.json", json_module.dumps(document, indent=1) + "\n")


def _show(
    title: str, columns: Sequence[str], rows: list[list[str]], remarks: Sequence[str], table: str,
    document: dict[str, Any], output: Path | None, *, json: bool,
) -> None:  # fmt: skip
    """Print what was found, as an object or as a table with sentences."""
    import json as json_module

    from kreisel.cli.terminal_tables import print_rows, print_sentences

    if json:
        typer.echo(json_module.dumps(document))
        return
    print_rows(title, columns, rows)
    print_sentences([f"· {remark}" for remark in remarks])
    typer.echo(f"for recording.toml:\n{table}")
    if output is not None:
        typer.echo(f"written: {output / 'allan.html'}, allan.json")

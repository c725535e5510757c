"""`kreisel static`: calibrate an IMU without a reference, by standstills in many attitudes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion, options
from kreisel.cli.watch import PORT

if TYPE_CHECKING:
    from contextlib import ExitStack

    from kreisel.cli.static_live import Guided
    from kreisel.static.guide import Estimator
    from kreisel.static.static_result import StaticOutcome


def static(
    recording: Path | None = typer.Argument(
        None, help="Recording: a folder, a table, an .mcap file, or a ROS bag; no poses. None with --live."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for the result."),
    gravity: float | None = typer.Option(
        None, min=9.7, max=9.9, help="Local gravity, m/s^2; else that of recording.toml ([site])."
    ),
    method: str | None = typer.Option(
        None,
        help="multi-position, six-position, ferraris, turntable or hinge; by default the one that the data show.",
        autocompletion=completion.one_of(completion.STATIC_METHODS),
    ),
    squareness: float = typer.Option(
        2.0,
        min=0.0,
        max=100.0,
        help="Standard deviation of the angles between the case's faces, mrad (six-position, ferraris).",
    ),
    constant_offsets: bool = typer.Option(
        False, "--constant-offsets", help="Take offsets to be constant, as other programs do; by default they may walk."
    ),
    only: str | None = typer.Option(
        None,
        help="gyroscope or accelerometer: the verdict is for this sensor.",
        autocompletion=completion.one_of(completion.SENSORS),
    ),
    imu: str | None = options.IMU,
    columns: list[str] = options.COLUMNS,
    live: str | None = typer.Option(
        None,
        help="Address of an IMU, such as csv://192.168.1.30:4000: record it, and say what to do next.",
        autocompletion=completion.imus,
    ),
    until: list[str] = typer.Option(
        [],
        help="With --live: accuracy to reach, 'gyroscope.cross_coupling=500ppm'; may be repeated.",
        autocompletion=completion.accuracies,
    ),
    seconds: float | None = typer.Option(None, min=1.0, help="With --live: longest duration of the recording."),
    dashboard: bool = typer.Option(False, "--dashboard", help="With --live: serve a page, for a phone too."),
    host: str = typer.Option("127.0.0.1", help="Address to serve the page on; others than this machine need a token."),
    port: int = PORT,
    json: bool = typer.Option(False, "--json", help="Print the result as one JSON object."),
) -> None:
    """Calibrate an IMU that was laid down, or held still, in many attitudes: no robot, no poses.

    A dozen attitudes or more, two seconds each, turned by hand in between; or the six faces of its case; or on a
    turntable (table0/data.csv). Exit status 3 if the result is rejected.
    """
    import json as json_module
    from contextlib import ExitStack
    from functools import partial

    from kreisel.batch.outcomes import REJECTED
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.static_live import Guided, end_shown, recording_kept
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import SENSORS
    from kreisel.static.static_methods import METHODS
    from kreisel.static.static_result import calibrate_static
    from kreisel.units import MRAD

    if method is not None and method not in METHODS:
        raise SettingsError(unknown_name("method", method, METHODS))
    if only is not None and only not in SENSORS:
        raise SettingsError(unknown_name("sensor after --only", only, SENSORS))
    if live is not None and recording is not None:
        raise SettingsError("give a recording, or --live ADDRESS, one of them")
    if live is None and (until or seconds is not None or dashboard):
        raise SettingsError("--until, --seconds and --dashboard are for a recording with --live ADDRESS")
    if output is not None:
        check_output(output)
    calibrate = partial(
        calibrate_static, gravity=gravity, constant_offsets=constant_offsets, only=only, method=method,
        squareness=squareness * MRAD,
    )  # fmt: skip
    how = Guided(tuple(until), only, method, seconds, dashboard, host, port, json)
    with ExitStack() as page:
        source = recording or _guided(live, output, how, calibrate, page)
        with recording_kept(source, live), end_shown(output, how) as show_end, progress_bar() as show:
            outcome = calibrate(load(source, imu=imu, columns=columns, progress=show), progress=show)
            write_static_result(outcome, output)
            show_end(outcome)
        if json:
            document = outcome.calibration.document
            typer.echo(json_module.dumps(document if output is None else {**document, "output": str(output)}))
        else:
            say_static(outcome, output)
    if not outcome.calibration.accepted:
        raise typer.Exit(REJECTED)


def _guided(live: str | None, output: Path | None, how: Guided, calibrate: Estimator, page: ExitStack) -> Path:
    """Record under guidance, and return the recording."""
    from kreisel.cli.static_live import record_guided
    from kreisel.errors import SettingsError

    if live is None:
        raise SettingsError("give a recording, or --live ADDRESS, one of them")
    if output is None:
        raise SettingsError("no output is given; -o OUT names a folder for the recording and the result")
    return record_guided(live, output, how, calibrate, page)


def write_static_result(outcome: StaticOutcome, output: Path | None) -> None:
    """Write the result and its report into a folder, if one is given."""
    from kreisel.calibration.result import RESULT_FILES
    from kreisel.files import replaced_together
    from kreisel.report.static_page import write_static

    if output is not None:
        with replaced_together(output, RESULT_FILES) as writing:
            outcome.calibration.write(writing)
            write_static(outcome, writing / "report.html")


def say_static(outcome: StaticOutcome, output: Path | None) -> None:
    """Print the result, and where it was written."""
    from kreisel.cli.terminal_tables import print_static

    print_static(outcome.calibration, outcome.warnings)
    typer.echo(f"up at the first standstill: {outcome.up} (an axis that is up reads +9.8 m/s^2)")
    where = f"{output}/calibration.yaml, report.html, covariance.npz"
    typer.echo("nothing written; -o OUT writes the result and a report" if output is None else f"written: {where}")

"""`kreisel robot`: calibrate the robot by the IMU that it moves."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion, options

if TYPE_CHECKING:
    from kreisel.calibration.arm_result import ArmCalibration


def robot(
    recordings: list[Path] = typer.Argument(
        ..., metavar="RECORDING...", help="Recordings with joint angles and robot.urdf; several are taken together."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for the result."),
    reference: str | None = options.REFERENCE,
    imu: str | None = options.IMU,
    columns: list[str] = options.COLUMNS,
    estimate: list[str] = typer.Option(
        [],
        help="Group to estimate whether or not the data show it, e.g. robot_gears; may be repeated.",
        autocompletion=completion.robot_terms,
    ),
    json: bool = typer.Option(False, "--json", help="Print the result as one JSON object."),
) -> None:
    """Calibrate the robot by the IMU: errors of its joints and links, and what they are worth on poses not used.

    Exit status 3 if the calibration is rejected.
    """
    import json as json_module

    from kreisel.batch.outcomes import REJECTED
    from kreisel.calibration.arm_calibration import arm_of, arm_of_all
    from kreisel.calibration.calibrate import run_calibration
    from kreisel.calibration.joint import calibrate_joint
    from kreisel.cli.joint import names_of
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads, releasing_memory
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import CalibrationSettings

    if output is not None:
        check_output(output)
    read_one = partial(load, reference=reference, imu=imu, columns=columns, executor=in_threads)
    settings = CalibrationSettings(estimated=tuple(estimate))
    with releasing_memory(), progress_bar() as show:
        read = [read_one(path, progress=show) for path in recordings]
        if len(read) == 1:
            found = arm_of(run_calibration(read[0], settings, show, executor=in_threads), show, in_threads)
        else:
            names = names_of(recordings)
            found = arm_of_all(calibrate_joint(read, settings, progress=show, names=names, executor=in_threads))
    if output is not None:
        _write(found, output)
    if json:
        document = found.document
        typer.echo(json_module.dumps(document if output is None else {**document, "output": str(output)}))
    else:
        _say(found, output)
    if not found.calibration.accepted:
        raise typer.Exit(REJECTED)


def _write(found: ArmCalibration, output: Path) -> None:
    """Write the result into a folder."""
    from kreisel.calibration.arm_result import ARM_FILES
    from kreisel.files import replaced_together
    from kreisel.report.arm_page import write_arm

    with replaced_together(output, ARM_FILES) as writing:
        found.write(writing)
        write_arm(found, writing / "report.html")


def _say(found: ArmCalibration, output: Path | None) -> None:
    """Print the errors that the motion shows, what they are worth, and the verdict."""
    from kreisel.cli.terminal_tables import print_arm

    print_arm(found)
    where = f"{output}/robot.yaml, robot.urdf, report.html, calibration.yaml, covariance.npz"
    typer.echo("nothing written; -o OUT writes the result and a report" if output is None else f"written: {where}")

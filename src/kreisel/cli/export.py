"""`kreisel export`: a calibration in the format of another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion

if TYPE_CHECKING:
    from kreisel.calibration.result import Calibration
    from kreisel.exchange.exported import ExportRequest
    from kreisel.exchange.exported_noise import ExportNoise


def export(
    calibration: Path = typer.Argument(..., help="Result folder, its calibration.yaml, or with --from another's file."),
    to: str = typer.Option(
        ...,
        "--to",
        help="kalibr, openvins, ros, px4, ardupilot, imu_tk, c, rust, matlab or json.",
        autocompletion=completion.one_of(completion.TARGETS),
    ),
    output: Path = typer.Option(..., "-o", "--output", help="File to write."),
    axes: str = typer.Option(
        "imu",
        help="Axes: the device's own (imu, gyro, nominal), or tool.",
        autocompletion=completion.one_of(completion.AXES),
    ),
    source: str | None = typer.Option(
        None,
        "--from",
        help="Read another program's file: kalibr, openvins or px4.",
        autocompletion=completion.one_of(completion.SOURCES),
    ),
    name: str = typer.Option("imu", help="Name of functions in source code."),
    grade: str | None = typer.Option(
        None, help="Grade whose noise figures are written, such as fog-mems.", autocompletion=completion.grades
    ),
    at_rest: Path | None = typer.Option(
        None, help="Recording of the device at rest, an hour or more: noise by its Allan deviation."
    ),
    noise: Path | None = typer.Option(
        None, help="allan.json of kreisel allan: noise at rest, or with --in-motion what a filter needs."
    ),
    rate: float | None = typer.Option(
        None, min=0.1, help="Samples a second in use; by default those of the recording."
    ),
    topic: str = typer.Option("/imu/data_raw", help="Topic that Kalibr or OpenVINS reads."),
    instance: int = typer.Option(0, min=0, max=3, help="Number of the sensor in an autopilot."),
    force: bool = typer.Option(False, "--force", help="Use a calibration that was rejected, and replace the file."),
) -> None:
    """Write a calibration for Kalibr, OpenVINS, ROS, PX4, ArduPilot, imu_tk, C, Rust, MATLAB, or as JSON.

    What the format cannot hold is printed, with its size.
    """
    from kreisel.application.corrected_files import check_usable
    from kreisel.calibration.device_axes import AXES
    from kreisel.calibration.result import Calibration
    from kreisel.errors import RecordingError
    from kreisel.exchange.exported import ExportRequest
    from kreisel.exchange.targets import read_from, target_named

    target = target_named(to)
    found = Calibration.load(calibration) if source is None else read_from(source, calibration, instance)
    check_usable(found, force=force)
    if found.verdict.caution:
        typer.echo(f"· {found.verdict.caution}", err=True)
    chosen = found.in_axes(axes)
    facts = chosen.recording
    request = ExportRequest(
        chosen,
        _noise(found, grade, at_rest, noise, needed=target.noise),
        name,
        rate or (None if facts is None or not facts.imu_rate_hz else facts.imu_rate_hz),
        topic,
        instance,
    )
    done = target.export(request)
    files = {output.with_name(f"{output.stem}{part}{output.suffix}"): text for part, text in done.files.items()}
    for path in files:
        if path.exists() and not force:
            raise RecordingError("exists already; delete it, give another name, or --force", file=path)
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
    typer.echo(f"axes {chosen.axes}: {AXES[chosen.axes]}")
    if chosen.verdict.unobservable:
        typer.echo(f"· not observable, do not rely on: {', '.join(chosen.verdict.unobservable)}")
    for text in done.lost:
        typer.echo(f"· not held: {text}")
    for note in (*done.notes, *_doubts(request)):
        typer.echo(f"· {note}")
    for path in files:
        typer.echo(f"written: {path}, {target.what}")


def _doubts(request: ExportRequest) -> list[str]:
    """Return what to know of readings, and what is odd about noise figures: far below what the filter had to assume."""
    from kreisel.exchange.exported_noise import NAMES

    estimator, counts = request.calibration.estimator, request.calibration.counts
    out = []
    if counts is not None:
        out.append(
            f"the parameters are for rad/s and m/s^2: of raw counts take first (count - {counts.rate_zero.tolist()}) * "
            f"{counts.rate:g}, and (count - {counts.acceleration_zero.tolist()}) * {counts.acceleration:g}"
        )
    if estimator is None:
        return out
    for name in ("gyro_density", "accel_density"):
        stated, assumed = request.noise.figures.get(name), getattr(estimator.noise, name)
        if stated and stated < 0.4 * assumed:
            out.append(
                f"the {NAMES[name]} written, {stated:.2g}, is far below the {assumed:.2g} that the calibration needed: "
                f"is {request.noise.sources[name]} of this device? --at-rest measures it"
            )
    return out


def _noise(
    calibration: Calibration, grade: str | None, at_rest: Path | None, written: Path | None, *, needed: bool
) -> ExportNoise:
    from kreisel.errors import SettingsError
    from kreisel.exchange.exported_noise import noise_of

    if not needed and any(one is not None for one in (grade, at_rest, written)):
        raise SettingsError("--grade, --at-rest and --noise are for formats with noise figures: kalibr and openvins")
    resting = None
    if at_rest is not None:
        from kreisel.formats.loading import load

        resting = load(at_rest).imu
    return noise_of(calibration, grade, resting, written)

"""`kreisel export`: a calibration, or those of a tray, in the format of another program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion

if TYPE_CHECKING:
    from kreisel.array.array_file import ArrayResult
    from kreisel.calibration.result import Calibration
    from kreisel.exchange.exported import ExportRequest
    from kreisel.exchange.exported_noise import ExportNoise


@dataclass(frozen=True)
class _Given:
    """What the command line states of noise, rate and topic."""

    grade: str | None
    at_rest: Path | None
    noise: Path | None
    rate: float | None
    topic: str


def export(
    calibration: Path = typer.Argument(
        ..., help="Result folder of an IMU or of several, calibration.yaml, or with --from another's file."
    ),
    to: str = typer.Option(
        ...,
        "--to",
        help="kalibr, openvins, ros, px4, ardupilot, imu_tk, c, rust, matlab or json; of several IMUs kalibr, urdf or "
        "ros-tf.",
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
    topic: str = typer.Option(
        "/{imu}/data_raw", help="Topic that Kalibr or OpenVINS reads; {imu} is the name of each of several IMUs."
    ),
    instance: int = typer.Option(0, min=0, max=3, help="Number of the sensor in an autopilot."),
    force: bool = typer.Option(False, "--force", help="Use a calibration that was rejected, and replace the file."),
) -> None:
    """Write a calibration for Kalibr, OpenVINS, ROS, PX4, ArduPilot, imu_tk, C, Rust, MATLAB, or as JSON.

    What the format cannot hold is printed, with its size. Of several IMUs calibrated at once: Kalibr, URDF, static
    transforms.
    """
    from kreisel.application.corrected_files import check_usable
    from kreisel.array.array_file import is_array, load_array
    from kreisel.calibration.device_axes import AXES
    from kreisel.calibration.result import Calibration
    from kreisel.exchange.exported import ExportRequest
    from kreisel.exchange.targets import read_from, target_named

    given = _Given(grade, at_rest, noise, rate, topic)
    if source is None and is_array(calibration):
        _check_axes(axes)
        _export_array(load_array(calibration), to, output, given, force=force)
        return
    target = target_named(to)
    found = Calibration.load(calibration) if source is None else read_from(source, calibration, instance)
    check_usable(found, force=force)
    if found.verdict.caution:
        typer.echo(f"· {found.verdict.caution}", err=True)
    chosen = found.in_axes(axes)
    request = ExportRequest(
        chosen,
        _noise(found, given, None, needed=target.noise),
        name,
        _rate(chosen, given),
        given.topic.replace("{imu}", "imu"),
        instance,
    )
    done = target.export(request)
    files = _written(done.files, output, force=force)
    typer.echo(f"axes {chosen.axes}: {AXES[chosen.axes]}")
    if chosen.verdict.unobservable:
        typer.echo(f"· not observable, do not rely on: {', '.join(chosen.verdict.unobservable)}")
    _say(done.lost, (*request.caveats, *done.notes, *(_doubts(request) if target.noise else [])), files, target.what)


def _export_array(array: ArrayResult, to: str, output: Path, given: _Given, *, force: bool) -> None:
    """Write the units of a tray into one file; other units than the reference are left out if they were rejected."""
    from kreisel.application.corrected_files import check_usable
    from kreisel.array.left_out import in_words
    from kreisel.calibration.device_axes import AXES
    from kreisel.errors import RecordingError, SettingsError
    from kreisel.exchange.exported import ArrayRequest, ExportRequest, PlacedUnit
    from kreisel.exchange.targets import array_target_named

    target = array_target_named(to, [unit.name for unit in array.units])
    if target.noise and "{imu}" not in given.topic:
        raise SettingsError(f"--topic {given.topic}: several IMUs need {{imu}} in it, as in '/{{imu}}/data_raw'")
    left_out, units, notes = dict(array.left_out), [], []
    for unit in array.units:
        if unit is not array.reference and not unit.calibration.accepted and not force:
            left_out[unit.name] = "rejected: " + "; ".join(unit.calibration.verdict.reasons)
            continue
        check_usable(unit.calibration, force=force, name=unit.name)
        own = unit.calibration.in_axes("imu")
        noise = _noise(unit.calibration, given, unit.name, needed=target.noise)
        request = ExportRequest(own, noise, rate_hz=_rate(own, given), topic=given.topic.replace("{imu}", unit.name))
        units.append(PlacedUnit(unit, request))
        if own.verdict.unobservable:
            notes.append(f"{unit.name}: not observable, do not rely on: {', '.join(own.verdict.unobservable)}")
        notes += [f"{unit.name}: {text}" for text in (*request.caveats, *(_doubts(request) if target.noise else []))]
    if len(units) < 2:
        raise RecordingError(f"no unit is left beside {array.reference.name}: {in_words(left_out)}", file=array.folder)
    done = target.export(ArrayRequest(array.folder.resolve().name, tuple(units), left_out))
    files = _written(done.files, output, force=force)
    typer.echo(f"places in the axes of {array.reference.name}, imu: {AXES['imu']}")
    for name, reason in left_out.items():
        typer.echo(f"· left out: {name}: {reason}{'' if name in array.left_out else '; --force uses it nevertheless'}")
    _say(done.lost, (*done.notes, *notes), files, target.what)


def _check_axes(axes: str) -> None:
    from kreisel.errors import SettingsError

    if axes != "imu":
        raise SettingsError(f"--axes {axes}: several IMUs are exported in the devices' own axes, imu; leave it out")


def _rate(calibration: Calibration, given: _Given) -> float | None:
    facts = calibration.recording
    return given.rate or (None if facts is None or not facts.imu_rate_hz else facts.imu_rate_hz)


def _written(texts: Mapping[str, str], output: Path, *, force: bool) -> list[Path]:
    """Write the files of an export and return their paths.

    Raises
    ------
    RecordingError
        If one exists, unless `force` is set.
    """
    from kreisel.errors import RecordingError
    from kreisel.files import write_whole

    files = {output.with_name(f"{output.stem}{part}{output.suffix}"): text for part, text in texts.items()}
    for path in files:
        if path.exists() and not force:
            raise RecordingError("exists already; delete it, give another name, or --force", file=path)
    for path, text in files.items():
        write_whole(path, text)
    return list(files)


def _say(lost: Sequence[str], notes: Sequence[str], files: Sequence[Path], what: str) -> None:
    for text in lost:
        typer.echo(f"· not held: {text}")
    for note in notes:
        typer.echo(f"· {note}")
    for path in files:
        typer.echo(f"written: {path}, {what}")


def _doubts(request: ExportRequest) -> list[str]:
    """Return what is odd about noise figures: far below what the filter had to assume."""
    from kreisel.exchange.exported_noise import NAMES

    estimator = request.calibration.estimator
    out: list[str] = []
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


def _noise(calibration: Calibration, given: _Given, imu: str | None, *, needed: bool) -> ExportNoise:
    """Return the noise figures of an IMU; imu: its name, where there are several."""
    from kreisel.errors import SettingsError
    from kreisel.exchange.exported_noise import noise_of

    if not needed and any(one is not None for one in (given.grade, given.at_rest, given.noise)):
        raise SettingsError("--grade, --at-rest and --noise are for formats with noise figures: kalibr and openvins")
    resting = None
    if given.at_rest is not None:
        from kreisel.formats.imus import imus_in
        from kreisel.formats.loading import load

        resting = load(given.at_rest, imu=imu if len(imus_in(given.at_rest)) > 1 else None).imu
    return noise_of(calibration, given.grade, resting, given.noise)

"""`kreisel calibrate`: calibrate an IMU from a recording."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.cli import completion, options

if TYPE_CHECKING:
    from collections.abc import Callable

    from kreisel.calibration.evidence import Injection
    from kreisel.calibration.limits import Limits
    from kreisel.calibration.outcome import Outcome
    from kreisel.calibration.result import Calibration
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.recording.recording import Recording


_DYNAMIC_ALONE = {
    "estimator": "--estimator", "sigma_points": "--sigma-points", "update_interval": "--update-interval",
    "polynomial_order": "--polynomial-order", "estimated": "--estimate", "fixed": "--fix", "priors": "--prior",
    "skew": "--skew", "size_effect": "--size-effect", "passes": "--passes", "use": "--use",
}  # fmt: skip
"""Settings that standstills alone do not have, with their options."""


def calibrate(
    recordings: list[Path] = typer.Argument(
        ..., metavar="RECORDING...", help="Recording: a folder, an .mcap file, or a ROS bag; several with --joint."
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for the result."),
    reference: str | None = options.REFERENCE,
    imu: str | None = options.ONE_OR_ALL_IMUS,
    columns: list[str] = options.COLUMNS,
    method: str = typer.Option(
        "dynamic",
        help="dynamic, or static: the older method, by standstills at poses alone (no lever arms).",
        autocompletion=completion.one_of(completion.METHODS),
    ),
    estimator: str | None = typer.Option(
        None,
        help="ekf (by default; spkf without orientations), iekf, spkf (the paper's), ukf, cdkf, ckf, batch or inverse.",
        autocompletion=completion.one_of(completion.ESTIMATORS),
    ),
    sigma_points: str | None = typer.Option(
        None,
        help="Of spkf, which it chooses: central-difference, unscented or cubature.",
        autocompletion=completion.one_of(completion.WEIGHTS),
    ),
    update_interval: float | None = typer.Option(
        None, help="Seconds between updates (robot 0.48, mocap 0.24; less in short recordings)."
    ),
    polynomial_order: int = typer.Option(1, help="1: offset and scale; 2: a quadratic term too; up to 5."),
    fix: list[str] = typer.Option(
        [],
        help="Group or parameter not to estimate, with or without a value (time_skew=0); may be repeated.",
        autocompletion=completion.parameters,
    ),
    prior: list[str] = typer.Option(
        [],
        help="What is known of a parameter, 'gyroscope.offset[0]=0+-1e-3', in SI; may be repeated.",
        autocompletion=completion.priors,
    ),
    estimate: list[str] = typer.Option(
        [],
        help="Error term to estimate whether or not the data show it, e.g. gyro_asymmetry; may be repeated.",
        autocompletion=completion.error_terms,
    ),
    skew: bool | None = typer.Option(
        None, help="Estimate the clocks' ratio; by default with orientations. Not where one clock stamps both."
    ),
    size_effect: str = typer.Option(
        "completed",
        help="Form of equation (2): completed or fox2005.",
        autocompletion=completion.one_of(completion.SIZE_EFFECTS),
    ),
    only: str | None = typer.Option(
        None,
        help="gyroscope or accelerometer: the verdict, and the exit status, are for this sensor.",
        autocompletion=completion.one_of(completion.SENSORS),
    ),
    use: str | None = typer.Option(
        None,
        help="orientations: leave out the reference's positions.",
        autocompletion=completion.one_of(completion.USES),
    ),
    passes: int | None = typer.Option(None, help="Passes over the data; by default until another pass changes little."),
    inject: bool = typer.Option(
        False, "--inject", help="Add known errors to the data and check whether they are found."
    ),
    validate: bool = typer.Option(True, help="Cross-validation for the report."),
    joint: bool = typer.Option(False, "--joint", help="One calibration from several recordings of one device."),
    same: list[str] = typer.Option(
        [],
        help="With --joint: what is the same in all recordings, offsets or mount; may be repeated.",
        autocompletion=completion.one_of(completion.SHARED),
    ),
    own: list[str] = typer.Option(
        [],
        help="With --joint: what is each recording's own, robot, site or reference; may be repeated.",
        autocompletion=completion.one_of(completion.SHARED),
    ),
    limits: str | None = typer.Option(
        None, help="Limits for conformity: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    json: bool = typer.Option(False, "--json", help="Print the result as one JSON object."),
) -> None:
    """Calibrate an IMU from a recording of its readings and of reference poses.

    Exit status 3 if the result is rejected; with --limits also if it does not conform, and 4 without a decision.
    """
    from kreisel.calibration.limits import limits_named
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads, releasing_memory
    from kreisel.errors import SettingsError
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.model.stated_parameters import parse_fixed, parse_priors

    _check_together(estimator, sigma_points, skew, parse_fixed(fix), estimate)
    settings = CalibrationSettings(
        estimator=estimator,
        sigma_points=sigma_points,
        update_interval=update_interval,
        polynomial_order=polynomial_order,
        fixed=parse_fixed(fix),
        priors=parse_priors(prior),
        estimated=tuple(estimate),
        skew=skew,
        size_effect=size_effect,
        passes=passes,
        only=only,
        use=use,
    )
    within = None if limits is None else limits_named(limits)
    if output is not None:
        check_output(output)
    read_one = partial(load, reference=reference, imu=imu, columns=columns, executor=in_threads)
    _check_method(method, settings, joint=joint, inject=inject)
    if joint:
        from kreisel.cli.joint import calibrate_together, say_joint

        found = calibrate_together(recordings, read_one, settings, _in_common(same, own), output)
        document = _with_output(found.calibration.document, output)
        _end(found.calibration, document, partial(say_joint, found, output), within, output, as_json=json)
        return
    if len(recordings) > 1 or same or own:
        raise SettingsError(
            "two tables of one recording: give the folder that holds them; recording.toml in it, or --map, says what "
            "their columns hold"
            if len(recordings) > 1 and all(path.suffix.lower() in (".csv", ".txt", ".tsv") for path in recordings)
            else "several recordings: --joint makes one calibration of them, `kreisel repeat` compares them"
            if len(recordings) > 1
            else "--same and --own are for several recordings with --joint"
        )
    if method == "static":
        _statically(read_one, recordings[0], settings, output, within, as_json=json)
        return
    injection: Injection | None = None
    if not columns and _all_units(read_one, recordings[0], imu, settings, output, within, (inject, validate, json)):
        return
    with releasing_memory(), progress_bar() as show:
        # modules are imported while the library reads
        read, run_calibration = in_threads([partial(read_one, recordings[0], progress=show), _calibrating])
        outcome = run_calibration(
            read, settings, show, executor=in_threads, validate=validate and output is not None, budget=True
        )
        if inject:
            from kreisel.calibration.injection import inject as inject_errors

            injection = inject_errors(outcome, show)
        if output is not None:
            _save(outcome, output, injection)
    document = _document(outcome, output, injection)
    _end(outcome.calibration, document, partial(_say, outcome, output, injection), within, output, as_json=json)


def _calibrating() -> Callable[..., Outcome]:
    """Return the function that calibrates; its modules, and those of the result's files, are imported."""
    import kreisel.report.report_page  # noqa: F401 - used once there is a result
    from kreisel.calibration.calibrate import run_calibration

    return run_calibration


def _all_units(
    read_one: Callable[..., Recording], path: Path, imu: str | None, settings: CalibrationSettings,
    output: Path | None, within: Limits | None, options: tuple[bool, bool, bool],
) -> bool:  # fmt: skip
    """Calibrate all IMUs of a recording, and end with the exit status for them; return False for one IMU.

    options: --inject, --validate and --json.
    """
    from kreisel.errors import SettingsError
    from kreisel.formats.imus import ALL, imus_in

    if imu not in (None, ALL):
        return False
    names, (inject, validate, as_json) = imus_in(path, imu), options
    if len(names) < 2 and imu is None:
        return False
    from kreisel.array.unit_readings import first_readable
    from kreisel.cli.tray import calibrate_units

    if inject:
        raise SettingsError("--inject is for one IMU; choose it with --imu")
    unread: dict[str, str] = {}
    base, readable = first_readable(lambda name: read_one(path, imu=name), path, names, unread)
    calibrate_units(base, readable, unread, settings, output, within, validate=validate, as_json=as_json)
    return True


def _check_together(
    estimator: str | None, sigma_points: str | None, skew: bool | None, fixed: dict[str, Any], estimated: list[str]
) -> None:
    """Raise an error for options that contradict each other."""
    from kreisel.errors import SettingsError

    if sigma_points is not None and estimator not in (None, "spkf"):
        raise SettingsError(f"--sigma-points is for spkf; leave it out, or --estimator {estimator}")
    if skew and "time_skew" in fixed:
        raise SettingsError("--skew and --fix time_skew contradict each other; leave one out")
    if both := [name for name in estimated if name in fixed]:
        raise SettingsError(f"--estimate {both[0]} and --fix {both[0]} contradict each other; leave one out")


def _check_method(method: str, settings: CalibrationSettings, *, joint: bool, inject: bool) -> None:
    """Raise an error for a method that there is not, or for options that do not go with it."""
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.model.calibration_settings import CalibrationSettings

    if method not in ("dynamic", "static"):
        raise SettingsError(unknown_name("method", method, ("dynamic", "static")))
    if joint and (inject or method == "static"):
        raise SettingsError(f"{'--inject' if inject else '--method static'} is for one recording; leave out --joint")
    if inject and method == "static":
        raise SettingsError("--inject is for the dynamic method; leave out --method static")
    if method == "static":
        usual = CalibrationSettings(fixed=[name for name in settings.fixed if name == "robot_placement"])
        for name, option in _DYNAMIC_ALONE.items():
            if getattr(settings, name) != getattr(usual, name):
                raise SettingsError(f"{option} is for the dynamic method; leave out --method static")


def _statically(
    read_one: Callable[..., Recording], path: Path, settings: CalibrationSettings, output: Path | None,
    within: Limits | None, *, as_json: bool,
) -> None:  # fmt: skip
    """Calibrate by standstills at poses alone; end with the exit status for the verdict."""
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.static import say_static, write_static_result
    from kreisel.cli.threads import in_threads
    from kreisel.static.by_robot import calibrate_by_robot

    with progress_bar() as show:
        outcome = calibrate_by_robot(read_one(path, progress=show), settings, show, in_threads)
    write_static_result(outcome, output)
    document = _with_output(outcome.calibration.document, output)
    _end(outcome.calibration, document, partial(say_static, outcome, output), within, output, as_json=as_json)


def _end(
    calibration: Calibration, document: dict[str, Any], say: Callable[[], None], limits: Limits | None,
    output: Path | None, *, as_json: bool,
) -> None:  # fmt: skip
    """Print a result, and whether it is within limits; end with the exit status for that."""
    import json

    from kreisel.batch.job_result import run_of_result
    from kreisel.batch.lot import units_of
    from kreisel.batch.unit_document import write_unit
    from kreisel.cli.conformity import as_table, conformity, sentence, status_of

    decision = None
    if limits is not None and calibration.accepted:
        judged, decision = conformity(calibration, limits)
        document["conformity"] = as_table(judged, decision, limits)
    if limits is not None and output is not None:
        write_unit(units_of([run_of_result(calibration)], limits)[0], limits, output, "report.html")
    if as_json:
        typer.echo(json.dumps(document))
    else:
        say()
        if decision is not None:
            typer.echo(sentence(judged, decision))
    if status := status_of(calibration, decision):
        raise typer.Exit(status)


def _in_common(same: list[str], own: list[str]) -> tuple[str, ...]:
    """Return what recordings have in common, by the options --same and --own."""
    from kreisel.calibration.sharing import DEFAULT, SHARED
    from kreisel.errors import SettingsError, unknown_name

    for word in (*same, *own):
        if word not in SHARED:
            raise SettingsError(unknown_name("word after --same or --own", word, SHARED))
    if both := [word for word in same if word in own]:
        raise SettingsError(f"{both[0]} cannot be both the same and each recording's own")
    return tuple(word for word in SHARED if word not in own and (word in DEFAULT or word in same))


def _save(
    outcome: Outcome,
    output: Path,
    injection: Injection | None,
) -> None:
    from kreisel.calibration.result import RESULT_FILES
    from kreisel.files import replaced_together
    from kreisel.report.report_page import write_report

    with replaced_together(output, RESULT_FILES) as writing:
        outcome.calibration.write(writing)
        write_report(outcome, writing / "report.html", injection=injection)


def _with_output(document: dict[str, Any], output: Path | None) -> dict[str, Any]:
    return document if output is None else {**document, "output": str(output)}


def _document(outcome: Outcome, output: Path | None, injection: Injection | None) -> dict[str, Any]:
    """Return the JSON object of a result."""
    document = _with_output(dict(outcome.calibration.document), output)
    if injection is not None:
        document["injection"] = {
            name: {"injected": float(a), "found": float(b), "standard_deviation": float(c)}
            for name, a, b, c in zip(
                injection.names, injection.injected, injection.found, injection.deviation, strict=True
            )
        }
    return document


def _say(outcome: Outcome, output: Path | None, injection: Injection | None) -> None:
    from kreisel.cli.terminal_tables import print_injection, print_result

    print_result(outcome.calibration, outcome.warnings)
    if injection is not None:
        print_injection(injection)
    if output is not None:
        robot = "" if outcome.calibration.robot_urdf is None else ", robot_calibrated.urdf"
        typer.echo(f"written: {output}/calibration.yaml, report.html, estimates.csv, covariance.npz{robot}")
    else:
        typer.echo("nothing written; -o OUT writes the result and a report")

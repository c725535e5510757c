"""`kreisel repeat`: calibrations of one device compared with each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kreisel.cli import completion

if TYPE_CHECKING:
    from kreisel.calibration.repeatability import Repeated
    from kreisel.calibration.result import Calibration


def repeat(
    recordings: list[Path] = typer.Argument(..., help="Recordings of one device, or results of `kreisel calibrate`."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for repeatability.html and .json."),
    fix: list[str] = typer.Option(
        [],
        help="Group or parameter not to estimate, NAME or NAME=VALUE; may be repeated.",
        autocompletion=completion.parameters,
    ),
    json: bool = typer.Option(False, "--json", help="Print the comparison as one JSON object."),
) -> None:
    """Calibrate an IMU from several recordings, each alone, and compare the results.

    If standard deviations are right, the chi-square per degree of freedom of every quantity is about 1.
    """
    import json as json_module

    from kreisel.calibration.repeatability import repeatability
    from kreisel.cli.joint import names_of
    from kreisel.cli.output import check_output
    from kreisel.errors import (
        EstimationError,
        ExcitationError,
        RecordingError,
        SettingsError,
        SynchronizationError,
    )
    from kreisel.model.stated_parameters import parse_fixed

    if len(recordings) < 2:
        raise SettingsError("give two or more recordings of one device")
    if output is not None:
        check_output(output)
    names, fixed = names_of(recordings), parse_fixed(fix)
    accepted, left_out = {}, {}
    for name, path in zip(names, recordings, strict=True):
        try:
            one = _calibration(path, fixed)
        except (RecordingError, SynchronizationError, ExcitationError, EstimationError) as error:
            if not path.exists():
                raise
            left_out[name] = str(error)
            continue
        if one.accepted:
            accepted[name] = one
        else:
            left_out[name] = f"rejected: {one.verdict.reasons[0]}" if one.verdict.reasons else "rejected"
    if len(accepted) < 2:
        why = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise SettingsError(f"fewer than two results are accepted ({why}); nothing to compare")
    runs, found = list(accepted), repeatability(list(accepted.values()))
    facts = _facts(found, left_out, [name for name, one in accepted.items() if one.budget is None])
    document = _document(found, runs, left_out)
    if output is not None:
        from kreisel.files import write_whole
        from kreisel.report.repeatability_page import write_repeatability

        output.mkdir(parents=True, exist_ok=True)
        write_repeatability(found, runs, facts, output / "repeatability.html")
        write_whole(output / "repeatability.json", json_module.dumps(document, indent=1) + "\n")
    if json:
        typer.echo(json_module.dumps(document))
        return
    _print(found, runs, facts)
    if output is not None:
        typer.echo(f"written: {output / 'repeatability.html'}, repeatability.json")


def _calibration(path: Path, fixed: dict[str, Any]) -> Calibration:
    from kreisel.calibration.result import Calibration

    if (path / "calibration.yaml").is_file():
        return Calibration.load(path)
    from kreisel.calibration.calibrate import run_calibration
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import CalibrationSettings

    with progress_bar() as show:
        read = load(path, executor=in_threads)
        outcome = run_calibration(read, CalibrationSettings(fixed=fixed), show, executor=in_threads, budget=True)
    return outcome.calibration


def _facts(found: tuple[Repeated, ...], left_out: dict[str, str], without_budget: list[str]) -> list[str]:
    from kreisel.calibration.repeatability import MAY_CHANGE

    facts = [f"{name} is not compared; {reason}" for name, reason in left_out.items()]
    if without_budget:
        facts.append(
            f"{', '.join(without_budget)}: results without a budget of uncertainty do not say what runs have in common "
            "(gravity, the robot), so that deviations of the means may be too small: compare the recordings instead."
        )
    large = [one for one in found if one.too_large and one.name not in MAY_CHANGE]
    if large:
        worst = ", ".join(f"{one.title.lower()} (x {one.factor:.1f})" for one in large)
        facts.append(
            f"Runs differ by more than their standard deviations: {worst}. Something differs between the runs that the "
            "model does not contain; the deviations of the means above are multiplied by these factors."
        )
    else:
        facts.append("Runs differ as much as their standard deviations say.")
    return facts


def _document(found: tuple[Repeated, ...], runs: list[str], left_out: dict[str, str]) -> dict[str, Any]:
    import numpy as np

    def numbers(values: Any) -> Any:
        return [
            numbers(v) if isinstance(v, list) else (v if np.isfinite(v) else None) for v in np.asarray(values).tolist()
        ]

    return {
        "runs": runs,
        "rejected": list(left_out),
        "reasons": left_out,
        "quantities": {
            one.name: {
                "unit": one.unit,
                "values": numbers(one.values),
                "standard_deviations": numbers(one.deviations),
                "mean": numbers(one.mean),
                "mean_standard_deviation": numbers(one.mean_sd),
                "scores": numbers(one.scores),
                "chi_square": one.chi_square if np.isfinite(one.chi_square) else None,
                "band": numbers(one.band),
            }
            for one in found
        },
    }


def _print(found: tuple[Repeated, ...], runs: list[str], facts: list[str]) -> None:
    from kreisel.cli.terminal_tables import print_rows, print_sentences
    from kreisel.report.repeatability_page import COLUMNS, cells_of

    rows = [cells_of(one, runs) for one in found]
    for title, shown in ((f"{len(runs)} recordings of one device", slice(1, 5)), ("means of the runs", slice(5, 8))):
        print_rows(title, [COLUMNS[0], *COLUMNS[shown]], [[row[0], *row[shown]] for row in rows], 1)
    print_sentences(facts)

"""`kreisel calibrate` of a recording with several IMUs: all units of a tray at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from kreisel.array.tray_outcome import TrayOutcome
    from kreisel.calibration.limits import Limits
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.recording.recording import Recording


def calibrate_units(
    base: Recording, names: Sequence[str], unread: Mapping[str, str], settings: CalibrationSettings,
    output: Path | None, limits: Limits | None, *, validate: bool, as_json: bool,
) -> None:  # fmt: skip
    """Calibrate all IMUs of a recording, write and print the results; end with the exit status for them.

    unread: why some of them cannot be read.
    """
    import json
    from dataclasses import replace

    from kreisel.array.tray import calibrate_tray
    from kreisel.array.unit_readings import unit_reader
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads, releasing_memory
    from kreisel.formats.folder import is_folder

    read = unit_reader(base, names[0])
    if not is_folder(base.path):
        read = _one_at_a_time(read)
    with releasing_memory(), progress_bar() as show:
        outcome = calibrate_tray(
            read, names, settings, show, executor=in_threads, validate=validate and output is not None
        )
        outcome = replace(outcome, left_out=(*unread.items(), *outcome.left_out))
        if output is not None:
            _write(outcome, output, limits)
    decisions, status = _judged(outcome, limits)
    if as_json:
        typer.echo(json.dumps(_document(outcome, decisions, output)))
    else:
        _say(outcome, decisions, output)
    if status:
        raise typer.Exit(status)


def _one_at_a_time(read: Callable[[str], Recording]) -> Callable[[str], Recording]:
    """Return a function that several threads may call, of one that must not be called again while it runs."""
    from threading import Lock

    lock = Lock()

    def call(name: str) -> Recording:
        with lock:
            return read(name)

    return call


def _write(outcome: TrayOutcome, output: Path, limits: Limits | None) -> None:
    """Write the folders of a tray, and with limits what is decided of each unit."""
    from kreisel.batch.jobs import Job
    from kreisel.batch.lot import PAGE_OF_TRAY, units_of
    from kreisel.batch.tray_runs import runs_of_tray, write_tray_results
    from kreisel.batch.unit_document import write_unit

    write_tray_results(outcome, output)
    if limits is None:
        return
    imus = (*(unit.name for unit in outcome.units), *dict(outcome.left_out))
    runs = runs_of_tray(outcome, Job(outcome.recording.name, outcome.recording.path, "", imus))
    for unit, judged in zip(outcome.units, units_of([run for run in runs if run.error is None], limits), strict=True):
        write_unit(judged, limits, output / unit.name, PAGE_OF_TRAY)


def _judged(outcome: TrayOutcome, limits: Limits | None) -> tuple[dict[str, Any], int]:
    """Return what is decided of each unit, and the exit status: 3 also if a unit could not be used."""
    from kreisel.batch.outcomes import REJECTED
    from kreisel.cli.conformity import as_table, conformity, sentence, status_of

    decisions, statuses = {}, {REJECTED} if outcome.left_out else set()
    for unit in outcome.units:
        decision = None
        if limits is not None and unit.calibration.accepted:
            judged, decision = conformity(unit.calibration, limits)
            decisions[unit.name] = {**as_table(judged, decision, limits), "sentence": sentence(judged, decision)}
        statuses.add(status_of(unit.calibration, decision))
    worst = next((status for status in (1, 3, 4) if status in statuses), 0)
    return decisions, worst


def _document(outcome: TrayOutcome, decisions: dict[str, Any], output: Path | None) -> dict[str, Any]:
    """Return the JSON object of a tray."""
    document: dict[str, Any] = {
        "array": outcome.array_document,
        "mean": outcome.mean.calibration.document,
        "imus": {unit.name: dict(unit.calibration.document) for unit in outcome.units},
        "left_out": dict(outcome.left_out),
    }
    for name, decision in decisions.items():
        document["imus"][name]["conformity"] = {key: value for key, value in decision.items() if key != "sentence"}
    return document if output is None else {**document, "output": str(output)}


def _say(outcome: TrayOutcome, decisions: dict[str, Any], output: Path | None) -> None:
    from kreisel.cli.terminal_tables import print_result, print_rows, print_sentences
    from kreisel.report.places import POSE_COLUMNS, pose_rows
    from kreisel.report.tray_page import COLUMNS, facts_of, unit_rows

    print_result(outcome.mean.calibration, outcome.mean.warnings)
    typer.echo(f"the results above are of the mean of {len(outcome.units)} units")
    print_rows(f"{outcome.recording.name}: units", list(COLUMNS), unit_rows(outcome), 3)
    print_rows(f"places in the axes of {outcome.reference}", list(POSE_COLUMNS), pose_rows(outcome.poses), 1)
    print_sentences(facts_of(outcome))
    for name, decision in decisions.items():
        typer.echo(f"{name}: {decision['sentence']}")
    if output is None:
        typer.echo("nothing written; -o OUT writes the results and a report")
        return
    folders = ", ".join(unit.name for unit in outcome.units[:3]) + (", …" if len(outcome.units) > 3 else "")
    files = "array.yaml, covariance.csv, units_covariance.npz, report.html, mean/report.html"
    typer.echo(f"written: {output}/{files}, and calibration.yaml in {folders}")

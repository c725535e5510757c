"""`kreisel batch` and `kreisel history`: many units, and one unit over the years."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.batch.outcomes import STATUS, most_serious
from kreisel.cli import completion

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from kreisel.batch.execution import Map
    from kreisel.batch.job_result import Run
    from kreisel.batch.lot import Unit


def batch(
    folder: Path = typer.Argument(..., help="Folder with recordings, at any depth."),
    output: Path = typer.Option(..., "-o", "--output", help="Folder for results; a batch in it is continued."),
    jobs: int | None = typer.Option(
        None, "--jobs", min=1, help="Local processes; by default 2, or 1 without the extra study."
    ),
    scheduler: str | None = typer.Option(None, help="A running dask scheduler, tcp://host:port, instead."),
    limits: str | None = typer.Option(
        None, help="Limits: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    database: Path | None = typer.Option(None, "--db", help="File of results, SQLite; by default OUT/results.db."),
    fix: list[str] = typer.Option(
        [], help="Group or parameter not to estimate; may be repeated.", autocompletion=completion.parameters
    ),
    links: bool = typer.Option(False, "--links", help="Follow links that lead out of FOLDER."),
    xlsx: bool = typer.Option(False, "--xlsx", help="Write table.xlsx too: units, capability, limits."),
    reports: bool = typer.Option(False, "--reports", help="Write a report for each unit; half as long again."),
    simulate: int | None = typer.Option(
        None, min=1, help="First simulate so many units into FOLDER, each another device; for a trial."
    ),
    seconds: float = typer.Option(60.0, min=30.0, help="With --simulate: length of each recording, s."),
    repeats: int = typer.Option(1, min=1, max=99, help="With --simulate: recordings of each unit."),
    json: bool = typer.Option(False, "--json", help="Print the summary as one JSON object."),
) -> None:
    """Calibrate all recordings in a folder, and write one table, one page and one file of results.

    Of a recording with several IMUs, a tray, every IMU is a unit.

    Exit status 0 if all units are good; 1 if one could not be calibrated; 3 if one was rejected or does not conform; 4
    if of one no decision can be made; the first of 1, 3, 4 that occurs. The last line names these units.
    """
    from kreisel.batch.batch_pages import write_batch
    from kreisel.batch.execution import Batch, calibrate_all, waiting_in
    from kreisel.batch.jobs import jobs_in, leaving
    from kreisel.batch.lot import pages_of, table, units_of
    from kreisel.batch.result_store import Store
    from kreisel.batch.unit_document import write_unit
    from kreisel.batch.workbook import check_workbook, write_workbook
    from kreisel.calibration.limits import limits_named
    from kreisel.cli.output import alone_in, check_output
    from kreisel.errors import SettingsError
    from kreisel.files import write_whole
    from kreisel.formats.folder import is_folder
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.model.stated_parameters import parse_fixed

    known = None if limits is None else limits_named(limits)
    if is_folder(output):
        raise SettingsError(f"-o {output}: is a recording; give another folder for results")
    if xlsx:
        check_workbook()
    check_output(output)
    distribute = _map(jobs, scheduler)
    if simulate is not None:
        _simulate(folder, simulate * repeats, seconds, repeats, distribute)
    settings = CalibrationSettings(fixed=parse_fixed(fix))
    work = Batch(jobs_in(folder, output, settings, links=links), settings, (output / "results").resolve(), reports)
    output.mkdir(parents=True, exist_ok=True)
    if not links and (left := leaving(folder)):
        typer.echo(f"links that lead out of {folder} are left out: {', '.join(left[:5])}; --links takes them", err=True)
    with alone_in(output), Store(database or output / "results.db") as store:
        total = sum(len(job.runs) for job in work.jobs)
        done = total - sum(len(work.jobs[number].runs) for number in waiting_in(work, store))
        if done and not json:
            typer.echo(f"{done} of {total} are done already")
        with _progress(total, done) as show:
            runs = calibrate_all(work, store, distribute, show)
    units = units_of(runs, known)
    write_whole(output / "table.csv", table(units))
    if xlsx:
        write_workbook(units, known, output / "table.xlsx")
    pages = pages_of(runs, reports=reports)
    for unit in units:
        write_unit(unit, known, work.results / unit.run.name, pages.get(unit.run.key))
    write_batch(units, known, f"{folder}", reports, output / "batch.html")
    _say(units, output, as_json=json)
    if status := most_serious(STATUS.get(unit.outcome, 0) for unit in units):
        raise typer.Exit(status)


def history(
    unit: str = typer.Argument(..., help="The unit: its serial number, or the recording's name."),
    database: Path = typer.Option(..., "--db", help="File of results of `kreisel batch`."),
    output: Path = typer.Option(..., "-o", "--output", help="Page to write, .html."),
    limits: str | None = typer.Option(
        None, help="Limits: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    of: str | None = typer.Option(None, "--type", help="Type, where devices of several have this serial number."),
    most: float | None = typer.Option(
        None, "--most-months", min=0.1, help="Longest interval between two calibrations, months."
    ),
) -> None:
    """Write the history of a unit: its errors over the years, how they age, and when it is due again."""
    from kreisel.batch.batch_pages import ageing_table, write_history
    from kreisel.batch.result_store import Store
    from kreisel.batch.unit_history import history_of, of_one_type
    from kreisel.calibration.limits import limits_named
    from kreisel.cli.terminal_tables import print_rows
    from kreisel.errors import RecordingError, SettingsError

    known = None if limits is None else limits_named(limits)
    if not database.is_file():
        raise RecordingError("no such file; `kreisel batch` makes it", file=database)
    with Store(database) as store:
        runs = store.of_unit(unit)
        if not runs:
            units = store.units()
            more = f" and {len(units) - 10} more" if len(units) > 10 else ""
            raise SettingsError(f"no unit '{unit}' in {database}; it has {', '.join(units[:10])}{more}")
    found = history_of(unit, of_one_type(unit, runs, of), known, most)
    output.parent.mkdir(parents=True, exist_ok=True)
    write_history(found, known, output)
    shown = ageing_table(found)
    print_rows(f"unit {unit}, {len(found.runs)} calibrations", shown.columns, [list(row.cells) for row in shown.rows])
    due = found.due.day.isoformat() if found.due.day is not None else "none"
    for name, reason in found.left_out:
        typer.echo(f"· left out: {name}, {reason}")
    typer.echo(f"next due: {due}; {found.due.reason}")
    typer.echo(f"written: {output}")


def _map(jobs: int | None, scheduler: str | None) -> Map:
    """Return what does the work: this process alone, local processes, or a cluster."""
    import importlib.util
    from functools import partial

    from kreisel.batch.execution import one_after_another

    if jobs is None:
        jobs = 2 if importlib.util.find_spec("distributed") is not None else 1
    if scheduler is None and jobs == 1:
        return one_after_another
    from kreisel.study.dask import check_installed, dask_map

    check_installed()
    return partial(dask_map, scheduler=scheduler, workers=jobs)


def _simulate(folder: Path, count: int, seconds: float, repeats: int, distribute: Map) -> None:
    """Write simulated recordings that are not in the folder yet."""
    from functools import partial

    from kreisel.batch.simulated import simulate_unit, unit_folder

    waiting = [number for number in range(count) if not unit_folder(folder, number, repeats).is_dir()]
    if not waiting:
        return
    typer.echo(f"simulate {len(waiting)} recordings of {seconds:g} s", err=True)
    with _progress(len(waiting), 0) as show:
        for _ in distribute(partial(simulate_unit, folder.resolve(), seconds, repeats), waiting):
            show(None)


class _progress:  # noqa: N801 - a context, as a function would be
    """Show on a terminal how many are done, and how many of those were not accepted."""

    def __init__(self, total: int, done: int) -> None:
        self._total, self._done, self._bad = total, done, 0

    def __enter__(self) -> Callable[[Run | None], None]:
        from kreisel.cli.progress_bar import progress_bar

        self._bar = progress_bar()
        show = self._bar.__enter__()

        def report(run: Run | None) -> None:
            self._done += 1
            self._bad += run is not None and not run.accepted
            if show is not None:
                text = f"{self._done} of {self._total}" + (f", {self._bad} not accepted" if self._bad else "")
                show(text, self._done / self._total)

        return report

    def __exit__(self, *error: object) -> None:
        self._bar.__exit__(*error)  # type: ignore[arg-type]


def _say(units: Sequence[Unit], output: Path, *, as_json: bool) -> None:
    import json

    from kreisel.batch.lot import counts, devices, good

    once = devices(units)
    if as_json:
        summary = {"units": len(once), "good": good(once), "outcomes": counts(once), "output": str(output)}
        summary["not_good"] = _not_good(units)
        typer.echo(json.dumps(summary))
        return
    own = ", ".join(f"{count} {outcome}" for outcome, count in counts(once).items())
    last = f", by the last of {len(units)} calibrations" if len(once) < len(units) else ""
    typer.echo(f"{len(once)} units: {own}; yield {100.0 * good(once) / len(once):.1f} %{last}")
    outlying = [unit for unit in units if unit.outliers]
    for unit in outlying[:5]:
        typer.echo(f"· {unit.run.name}: {unit.outliers[0].text}")
    if len(outlying) > 5:
        typer.echo(f"· and {len(outlying) - 5} more outliers")
    typer.echo(f"written: {output}/batch.html, table.csv, results.db, results/")
    if named := _not_good(units):
        typer.echo("not good: " + "; ".join(f"{outcome}: {_some(names)}" for outcome, names in named.items()))


def _not_good(units: Sequence[Unit]) -> dict[str, list[str]]:
    """Return the names of recordings by what became of them, the most serious first; without those that are good."""
    out: dict[str, list[str]] = {outcome: [] for outcome in STATUS}
    for unit in units:
        if unit.outcome in out:
            out[unit.outcome].append(unit.run.name)
    return {outcome: names for outcome, names in out.items() if names}


def _some(names: Sequence[str], most: int = 10) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")

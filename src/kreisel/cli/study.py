"""`kreisel study`: Monte-Carlo in the virtual cell."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from kreisel.cli import completion
from kreisel.cli.command_help import help_of

if TYPE_CHECKING:
    from kreisel.simulation.cell_settings import Cell
    from kreisel.study.bound import Bound
    from kreisel.study.robustness import Row
    from kreisel.study.summary import Summary
    from kreisel.study.trial import Trial

Result = TypeVar("Result")

app = typer.Typer(no_args_is_help=True, help="Monte-Carlo studies in the virtual cell.", rich_markup_mode=None)


def _command(name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return what adds a command, with its line in the list and its examples."""
    said = help_of(f"study {name}")
    return app.command(name, short_help=said.summary, epilog=said.epilog)


_CELL = typer.Argument(None, help="CELL.toml; the default cell if not given.")
_TRIALS = typer.Option(100, "--trials", help="Number of trials, including those already done.", min=1)
_OUTPUT = typer.Option(
    Path("study"), "-o", "--output", help="Folder for the trials; a folder with trials is continued."
)
_SCHEDULER = typer.Option(None, help="A running dask scheduler, tcp://host:port.")
_WORKERS = typer.Option(2, help="Local processes, if no scheduler is given.", min=1)
_JSON = typer.Option(False, "--json", help="Print the summary as one JSON object.")
"""Arguments of several commands. Defaults are chosen: of 100 trials a standard deviation is known to 7 %, 1 /
sqrt(200); two processes suit any machine."""


@_command("consistency")
def consistency(
    cell: Path | None = _CELL,
    trials: int = _TRIALS,
    output: Path = _OUTPUT,
    scheduler: str | None = _SCHEDULER,
    workers: int = _WORKERS,
    json: bool = _JSON,
) -> None:
    """Check the standard deviations: error over standard deviation, NEES and coverage over many trials."""
    summary = _study(cell, trials, output, scheduler, workers, "Consistency")
    columns, rows = _ratios(summary)
    _say(summary, rows, columns, output, as_json=json)


@_command("accuracy")
def accuracy(
    cell: Path | None = _CELL,
    trials: int = _TRIALS,
    output: Path = _OUTPUT,
    scheduler: str | None = _SCHEDULER,
    workers: int = _WORKERS,
    bounds: int = typer.Option(3, help="Trials whose Cramer-Rao bound is computed too.", min=0),
    json: bool = _JSON,
) -> None:
    """Print the accuracy of calibrations: rms errors over many trials, compared with the smallest possible ones."""
    summary = _study(cell, trials, output, scheduler, workers, "Accuracy")
    best = _bounds(_described(cell), bounds)
    rows = []
    for g in summary.groups:
        least = best.get(g.title)
        rows.append(
            [
                g.title,
                g.unit,
                f"{g.error:.3g}",
                *(["", ""] if not least else [f"{least:.3g}", f"{g.error / least:.2f}"]),
            ]
        )
    _say(summary, rows, ["group", "unit", "rms error", "bound", "error / bound"], output, as_json=json)


@_command("bound")
def bound(
    cell: Path | None = _CELL,
    trials: int = typer.Option(
        3, "--trials", help="Number of motions for which the bound is computed and averaged.", min=1
    ),
    json: bool = _JSON,
) -> None:
    """Print the smallest possible errors: the posterior Cramer-Rao bound along the true motion."""
    import json as json_module

    from kreisel.cli.terminal_tables import print_rows
    from kreisel.study.summary import GROUPS

    best = _bounds(_described(cell), trials)
    if json:
        typer.echo(json_module.dumps({"trials": trials, "bound": best}))
        return
    rows = [[title, unit, f"{best[title]:.3g}"] for _, title, unit, _ in GROUPS if title in best]
    print_rows("posterior Cramer-Rao bound, rms over each group", ["group", "unit", "bound"], rows)


@_command("robustness")
def robustness(
    output: Path = typer.Option(
        Path("robustness"), "-o", "--output", help="Folder for the results; a folder with results is continued."
    ),
    seeds: int = typer.Option(3, help="Runs of each situation.", min=1, max=9999),
    workers: int = _WORKERS,
    scheduler: str | None = _SCHEDULER,
    only: list[str] = typer.Option(
        [], help="Name of a situation; may be repeated. All if not given.", autocompletion=completion.situations
    ),
    random: int = typer.Option(
        0, help="Number of runs with random errors outside the model, instead of situations.", min=0
    ),
    first: int = typer.Option(1, help="Number of the first of these.", min=1),
    seconds: float = typer.Option(150.0, help="Length of every recording, s.", min=20.0),
    write: Path | None = typer.Option(None, help="Write the recordings into this folder, and calibrate nothing."),
    json: bool = typer.Option(False, "--json", help="Print totals and rows as one JSON object."),
) -> None:
    """Calibrate hundreds of cells with errors outside the model: results must be right, or rejected."""
    from kreisel.cli.output import check_output
    from kreisel.errors import SettingsError
    from kreisel.study.dask import check_installed
    from kreisel.study.robustness import RowFile, numbers, random_numbers, run_numbered, write_numbered
    from kreisel.study.situations import RANDOM

    if random and only:
        raise SettingsError("--random has situations of its own; leave out --only")
    wanted = random_numbers(random, first) if random else numbers(seeds, only, seconds)
    how = {"scheduler": scheduler, "workers": workers}
    if write is not None:
        check_installed()
        check_output(write)
        write.mkdir(parents=True, exist_ok=True)
        _each(partial(write_numbered, seconds, write), wanted, how, lambda _name: None)
        _say_written(len(wanted), write, as_json=json)
        return
    check_installed()
    check_output(output)
    file = RowFile(output, seconds)
    _each(partial(run_numbered, seconds), file.missing(wanted, seconds), how, file.add)
    rows = file.rows()
    if random:
        rows = [row for row in rows if row.name == RANDOM and first <= row.seed < first + random]
    else:
        rows = [row for row in rows if row.name != RANDOM and row.seed <= seeds and (not only or row.name in only)]
    _say_robustness(rows, output, as_json=json)


@_command("methods")
def methods(
    output: Path = typer.Option(
        Path("methods"), "-o", "--output", help="Folder for the results; a folder with results is continued."
    ),
    seeds: int = typer.Option(10, help="Recordings of each cell.", min=1, max=9999),
    workers: int = _WORKERS,
    scheduler: str | None = _SCHEDULER,
    seconds: float = typer.Option(60.0, help="Length of every recording, s.", min=20.0),
    of: str = typer.Option(
        "",
        "--methods",
        help="Estimators, with commas between; all if not given.",
        autocompletion=completion.several_of(completion.STUDY_METHODS),
    ),
    json: bool = _JSON,
) -> None:
    """Compare estimators: devices, references, motions, and first values that are wrong by 1 or 10 degrees."""
    import json as json_module
    from dataclasses import asdict

    from kreisel.cli.output import check_output
    from kreisel.cli.terminal_tables import print_rows
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.report.study_page import write_methods
    from kreisel.study.dask import check_installed
    from kreisel.study.method_rows import COLUMNS, METHODS, MethodFile, numbers, summaries, table
    from kreisel.study.methods import run_numbered

    check_installed()
    check_output(output)
    chosen = tuple(name.strip() for name in of.split(",") if name.strip()) or METHODS
    for name in chosen:
        if name not in METHODS:
            raise SettingsError(f"--methods {of}: {unknown_name('estimator', name, METHODS)}")
    file, wanted = MethodFile(output, seconds, chosen), numbers(seeds)
    how = {"scheduler": scheduler, "workers": workers}
    _each(partial(run_numbered, seconds, chosen), file.missing(wanted), how, file.add)
    rows = [row for row in file.rows() if row.seed <= seeds]
    found, lines = summaries(rows), table(rows)
    write_methods(lines, COLUMNS, rows, output / "report.html")
    if json:
        typer.echo(json_module.dumps({"methods": [asdict(one) for one in found], "output": str(output)}))
        return
    print_rows("estimators, from first values that are wrong", COLUMNS, lines)
    typer.echo(f"written: {output}/methods.csv, report.html")


def _each(
    work: Callable[[int], Result], missing: list[int], how: dict[str, Any], take: Callable[[Result], None]
) -> None:
    """Do the work for every number, in processes, and show the progress."""
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.study.dask import dask_map

    if not missing:
        return
    with progress_bar() as show:
        for done, result in enumerate(dask_map(work, missing, **how), start=1):
            take(result)
            if show is not None:
                show(f"{done} of {len(missing)} runs", done / len(missing))


def _say_written(count: int, folder: Path, *, as_json: bool) -> None:
    """Print how many recordings were written."""
    import json

    document = json.dumps({"recordings": count, "output": str(folder)})
    typer.echo(document if as_json else f"written: {count} recordings in {folder}")


def _say_robustness(rows: list[Row], output: Path, *, as_json: bool) -> None:
    """Write the page of a robustness study, and print its table or its JSON."""
    from kreisel.report.study_page import write_robustness
    from kreisel.study.robustness import COLUMNS, as_document, sentences, table, total

    totals = total(rows)
    lines, facts = table(rows), sentences(totals)
    lead = f"{len(lines)} situations, {len(rows)} runs; worst errors in standard deviations of the result"
    write_robustness(lead, lines, COLUMNS, facts, output / "report.html")
    if as_json:
        import json

        typer.echo(json.dumps(as_document(totals, rows)))
        return
    from kreisel.cli.terminal_tables import print_rows, print_sentences

    print_rows("verdicts, and errors over standard deviations", COLUMNS, lines, 3)
    print_sentences(facts)
    typer.echo(f"written: {output}/robustness.csv, report.html")


def _described(cell: Path | None) -> Cell:
    from kreisel.simulation.cell_settings import Cell, read_cell

    return Cell() if cell is None else read_cell(cell)


def _study(cell: Path | None, trials: int, output: Path, scheduler: str | None, workers: int, title: str) -> Summary:
    """Run the missing trials, write the report, and return the summary."""
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import EstimationError
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.report.study_page import write_study
    from kreisel.study.dask import check_installed, dask_map
    from kreisel.study.monte_carlo import run_trial
    from kreisel.study.stored_trials import Results
    from kreisel.study.summary import GROUPS, scores_of, summarise

    described, settings = _described(cell), CalibrationSettings()
    check_installed()
    check_output(output)
    results = Results(output, described, settings)
    missing = [k for k in range(trials) if k not in results.done]
    with progress_bar() as show:
        if missing:
            work: Callable[[int], Trial] = partial(run_trial, described, settings)
            for trial in dask_map(work, missing, scheduler=scheduler, workers=workers):
                results.add(trial)
                if show is not None:
                    show(f"{len(results.done)} of {trials} trials", len(results.done) / trials)
    counted = [trial for trial in results.trials() if trial.number < trials]
    summary = summarise(counted)
    if summary is None:
        raise EstimationError(f"all {trials} trials failed; the first: {counted[0].failure}")
    scores = [(title, own) for stem, title, _, _ in GROUPS if (own := scores_of(counted, stem))]
    columns, rows = _ratios(summary)
    lead = f"{described.imu.grade} on {described.robot.model}, {described.seconds:g} s, {summary.trials} trials"
    write_study(title, lead, rows, columns, _facts(summary), scores, output / "report.html")
    return summary


def _bounds(cell: Cell, trials: int) -> dict[str, float]:
    """Return the rms bound of every group, by its title, in its unit."""
    import numpy as np

    from kreisel.cli.progress_bar import progress_bar
    from kreisel.model.calibration_settings import CalibrationSettings
    from kreisel.study.bound import cramer_rao_bound
    from kreisel.study.summary import GROUPS

    found: list[Bound] = []
    with progress_bar() as show:
        for k in range(trials):
            if show is not None:
                show("bound", k / trials)
            found.append(cramer_rao_bound(cell, CalibrationSettings(), k))
    out = {}
    for stem, title, _, factor in GROUPS:
        own = [b.deviation[i] for b in found for i, name in enumerate(b.names) if name.startswith(stem)]
        if own:
            out[title] = factor * float(np.sqrt(np.mean(np.square(own))))
    return out


def _ratios(summary: Summary) -> tuple[list[str], list[list[str]]]:
    """Return columns and rows of the table of groups."""
    columns = ["group", "unit", "rms error", "rms sd", "error / sd", "its 95 % interval", "within 68 %", "within 95 %"]
    rows = []
    for g in summary.groups:
        low, high = g.ratio_bounds
        shares = [f"{100.0 * share:.1f} %" for share in g.coverage.values()]
        values = [f"{g.error:.3g}", f"{g.deviation:.3g}", f"{g.ratio:.2f}", f"{low:.2f} to {high:.2f}"]
        rows.append([g.title, g.unit, *values, *shares])
    return columns, rows


def _facts(summary: Summary) -> list[str]:
    low, high = summary.nees_bounds
    return [
        f"NEES per degree of freedom {summary.nees:.3f}; a consistent one lies within {low:.3f} to {high:.3f} (95 %)",
        f"NIS per degree of freedom: path {summary.nis_path:.2f}, standstill {summary.nis_standstill:.2f}",
        f"{summary.trials} trials, {summary.failed} failed, {summary.rejected} rejected by their own verdict and left "
        f"out; {summary.seconds:.1f} s each",
    ]


def _say(summary: Summary, rows: list[list[str]], columns: list[str], output: Path, *, as_json: bool) -> None:
    import json
    from dataclasses import asdict

    if as_json:
        document: dict[str, Any] = asdict(summary)
        document["output"] = str(output)
        typer.echo(json.dumps(document))
        return
    from kreisel.cli.terminal_tables import print_rows, print_sentences

    print_rows("error compared with the standard deviation of the calibration", columns, rows)
    print_sentences(_facts(summary))
    typer.echo(f"written: {output}/trials.csv, parameters.csv, report.html")

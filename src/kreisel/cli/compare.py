"""`kreisel compare`: estimators side by side on one recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from kreisel.calibration.by_method import ByMethod


def compare(
    recording: Path = typer.Argument(..., help="Recording, as for `kreisel calibrate`."),
    methods: str = typer.Option("spkf,ekf,batch", help="Estimators: spkf, ukf, cdkf, ckf, ekf, batch; commas between."),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for comparison.html and comparison.json."),
    json: bool = typer.Option(False, "--json", help="Print the comparison as one JSON object."),
) -> None:
    """Calibrate one recording by several estimators and compare the results.

    Differences are in the standard deviations of the first. With truth.json in a simulated recording, errors are shown.
    """
    import json as json_module

    from kreisel.calibration.by_method import document_of
    from kreisel.calibration.method_comparison import compare_methods
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.cli.threads import in_threads
    from kreisel.errors import EstimationError, SettingsError, unknown_name
    from kreisel.formats.loading import load
    from kreisel.model.calibration_settings import ESTIMATORS

    names = list(dict.fromkeys(name.strip() for name in methods.split(",") if name.strip()))
    for name in names:
        if name not in ESTIMATORS:
            raise SettingsError(f"--methods {methods}: {unknown_name('estimator', name, ESTIMATORS)}")
    if len(names) < 2:
        raise SettingsError(f"--methods {methods}: give two or more; known are {', '.join(ESTIMATORS)}")
    if output is not None:
        check_output(output)
    truth = _truth(recording)
    with progress_bar() as show:
        read = load(recording, executor=in_threads)
        found = compare_methods(read, names, show, in_threads)
    if all(one.calibration is None for one in found):
        raise EstimationError("; ".join(f"{one.name}: {one.error}" for one in found))
    document = document_of(found, truth)
    if output is not None:
        from kreisel.report.comparison_page import write_comparison

        output.mkdir(parents=True, exist_ok=True)
        write_comparison(recording.name, found, truth, output / "comparison.html")
        (output / "comparison.json").write_text(json_module.dumps(document, indent=1) + "\n", encoding="utf-8")
    if json:
        typer.echo(json_module.dumps(document))
        return
    _print(found, truth)
    if output is not None:
        typer.echo(f"written: {output / 'comparison.html'}, comparison.json")


def _truth(recording: Path) -> dict[str, float]:
    """Return the true values beside a simulated recording; none where there is no such file."""
    import json as json_module

    from kreisel.calibration.by_method import parameters_in
    from kreisel.errors import RecordingError

    file = recording / "truth.json" if recording.is_dir() else recording.with_suffix(".truth.json")
    if not file.is_file():
        return {}
    try:
        content = json_module.loads(file.read_text(encoding="utf-8"))
        known = parameters_in(content)
        known |= {"timing.offset": float(content["time_offset"]), "timing.skew": float(content["time_skew"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{file}: not the true values of a simulated recording ({error}); remove it") from error
    return known


def _print(found: tuple[ByMethod, ...], truth: Mapping[str, float]) -> None:
    from rich.markup import escape
    from rich.table import Table

    from kreisel.calibration.by_method import GROUPS
    from kreisel.cli.terminal_tables import wide_console
    from kreisel.report.comparison_page import columns_of, facts_of, rows_of

    out, names, rows = wide_console(), columns_of(truth), rows_of(found, truth)
    own = [place for place, name in enumerate(names) if name not in GROUPS.values()]
    apart = [0, *(place for place in range(len(names)) if place not in own)]
    first = next(one.name for one in found if one.calibration is not None)
    for title, shown in (("estimators side by side", own), (f"difference from {first}, in its deviations", apart)):
        table = Table(title=title, title_justify="left")
        for place in shown:
            table.add_column(names[place], justify="left" if names[place] in ("estimator", "result") else "right")
        for row in rows:
            table.add_row(*(escape(row[place]) for place in shown))
        out.print(table)
    for fact in facts_of(found, truth):
        out.print(fact, markup=False)

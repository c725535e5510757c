"""`kreisel compare`: estimators side by side on recordings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kreisel.cli import completion

if TYPE_CHECKING:
    from kreisel.calibration.by_method import Comparison
    from kreisel.calibration.own_estimator import Estimator
    from kreisel.progress import Progress


def compare(
    recordings: list[Path] = typer.Argument(..., help="Recordings, as for `kreisel calibrate`."),
    methods: str | None = typer.Option(
        None,
        help="Estimators, with commas between: those of `kreisel calibrate --estimator`, and own ones as FILE.py:NAME; "
        "by default spkf,ekf,batch. Without poses static, constant-offsets, tedaldi: by default all.",
        autocompletion=completion.several_of(completion.COMPARED),
    ),
    output: Path | None = typer.Option(None, "-o", "--output", help="Folder for comparison.html and comparison.json."),
    json: bool = typer.Option(False, "--json", help="Print the comparison as one JSON object."),
) -> None:
    """Calibrate recordings by several estimators and compare the results.

    Differences are in the standard deviations of the first. With truth.json in a simulated recording, errors are shown.
    Recordings without poses are calibrated by their standstills.
    """
    import json as json_module
    from math import isfinite

    from kreisel.calibration.by_method import document_of_all
    from kreisel.cli.joint import names_of
    from kreisel.cli.output import check_output
    from kreisel.cli.progress_bar import progress_bar
    from kreisel.errors import EstimationError
    from kreisel.report.comparison_page import over_recordings

    if output is not None:
        check_output(output)
    compared, runs = [], names_of(recordings)
    for path in recordings:
        with progress_bar() as show:
            one = _compared(path, methods, show)
        if not one.done:
            raise EstimationError(f"{path}: " + "; ".join(f"{each.name}: {each.error}" for each in one.found))
        compared.append(one)
    document = document_of_all(compared, runs)
    if len(compared) > 1:
        document["chi_square"] = {
            name: {one.name: one.chi_square if isfinite(one.chi_square) else None for one in found}
            for name, found in over_recordings(compared).items()
        }
    if output is not None:
        from kreisel.files import write_whole
        from kreisel.report.comparison_page import write_comparison

        output.mkdir(parents=True, exist_ok=True)
        write_comparison(compared, runs, output / "comparison.html")
        write_whole(output / "comparison.json", json_module.dumps(document, indent=1) + "\n")
    if json:
        typer.echo(json_module.dumps(document))
        return
    _print(compared, runs)
    if output is not None:
        typer.echo(f"written: {output / 'comparison.html'}, comparison.json")


def _compared(path: Path, methods: str | None, show: Progress | None) -> Comparison:
    from kreisel.calibration.method_comparison import compare_methods
    from kreisel.cli.threads import in_threads
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.formats.loading import load

    read = load(path, executor=in_threads)
    if read.reference is not None:
        return compare_methods(read, _chosen(methods or "spkf,ekf,batch"), show, in_threads, _truth(path))
    from kreisel.static.static_comparison import STATIC_ESTIMATORS, compare_static

    names = STATIC_ESTIMATORS if methods is None else tuple(_names(methods))
    for name in names:
        if name not in STATIC_ESTIMATORS:
            unknown = unknown_name("estimator", name, STATIC_ESTIMATORS)
            raise SettingsError(f"--methods {methods}: {unknown}, for {path} has no poses")
    return compare_static(read, names, show)


def _names(methods: str) -> list[str]:
    """Return two or more names with commas between."""
    from kreisel.errors import SettingsError

    names = list(dict.fromkeys(name.strip() for name in methods.split(",") if name.strip()))
    if len(names) < 2:
        raise SettingsError(f"--methods {methods}: give two or more")
    return names


@cache
def _chosen(methods: str) -> list[str | Estimator]:
    """Return the names of kreisel's estimators, and own ones."""
    from kreisel.calibration.own_code import load_estimator
    from kreisel.errors import SettingsError, unknown_name
    from kreisel.model.calibration_settings import ESTIMATORS

    names = _names(methods)
    chosen: list[str | Estimator] = []
    for name in names:
        own = ":" in name or name.endswith(".py")
        if not own and name not in ESTIMATORS:
            raise SettingsError(f"--methods {methods}: {unknown_name('estimator', name, ESTIMATORS)}")
        chosen.append(load_estimator(name) if own else name)
    called = [one if isinstance(one, str) else one.name for one in chosen]
    twice = next((name for name in called if called.count(name) > 1), None)
    if twice is not None:
        raise SettingsError(f"--methods {methods}: two estimators are called {twice}; give your own another name")
    return chosen


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


def _print(compared: Sequence[Comparison], runs: Sequence[str]) -> None:
    from kreisel.calibration.by_method import GROUPS
    from kreisel.cli.terminal_tables import print_rows, print_sentences
    from kreisel.report.comparison_page import (
        OVER_EXPECTED,
        chi_squares,
        columns_of,
        facts_of,
        over_recordings,
        rows_of,
    )

    names, rows = columns_of(compared), rows_of(compared, runs)
    texts = [place for place, name in enumerate(names) if name in ("recording", "estimator", "result")]
    groups = [place for place, name in enumerate(names) if name in (*GROUPS.values(), OVER_EXPECTED)]
    own = [place for place in range(len(names)) if place not in groups]
    keys = [place for place in texts if names[place] != "result"]
    tables = [
        ("estimators side by side", [names[i] for i in own], [[row[i] for i in own] for row in rows]),
        (
            f"difference from {compared[0].first.name}, in its deviations",
            [names[i] for i in (*keys, *groups)],
            [[row[i] for i in (*keys, *groups)] for row in rows],
        ),
    ]
    together = over_recordings(compared)
    if together:
        columns, squares = chi_squares(together)
        tables.append(("chi-square per degree of freedom over the recordings", list(columns), squares))
    for title, heads, cells in tables:
        words = sum(name in ("recording", "estimator", "result", "quantity") for name in heads)
        print_rows(title, heads, cells, words)
    print_sentences(facts_of(compared, runs))

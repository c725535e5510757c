"""A Monte-Carlo study on one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from kreisel.report import plots
from kreisel.report.cells import Row, Table
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill
from kreisel.report.thinning import Curve
from kreisel.study.method_rows import MethodRow


def write_study(title: str, lead: str, rows: list[list[str]], columns: list[str], facts: list[str],
                scores: list[tuple[str, list[float]]], path: Path) -> None:  # fmt: skip
    """Write the page of a study as one HTML file that works offline.

    Parameters
    ----------
    rows, columns
        The table of groups.
    facts
        Sentences on all trials together.
    scores
        For each group its name and all errors over their standard deviations.
    """
    figures = [_scores(scores)] if scores else []
    table = Table(
        "Error and the calibration's standard deviation", tuple(columns), tuple(Row(tuple(r)) for r in rows), text=2
    )
    page = fill("study.html", figures, title=title, lead=lead, table_of_groups=table, facts=facts, figures=figures)
    path.write_text(page, encoding="utf-8")


def write_robustness(lead: str, rows: list[list[str]], columns: Sequence[str], facts: list[str], path: Path) -> None:
    """Write the page of a robustness study: its table of situations, and sentences on all runs together."""
    table = Table(
        "Verdicts, and errors over standard deviations", tuple(columns), tuple(Row(tuple(r)) for r in rows), text=3
    )
    page = fill("study.html", [], title="Robustness", lead=lead, table_of_groups=table, facts=facts, figures=[])
    path.write_text(page, encoding="utf-8")


def write_methods(lines: list[list[str]], columns: Sequence[str], rows: Sequence[MethodRow], path: Path) -> None:
    """Write the page of a study of estimators: its table, and failures and errors cell by cell."""
    figures = [_by_cell(rows, title, quantity, of) for title, quantity, of in (
        ("Runs that end elsewhere than at the truth", "share, %", _share_failed),
        ("Error over standard deviation of the others", "rms", _ratio_of_good),
        ("Time until nothing moves", "s, median", _time),
    )]  # fmt: skip
    table = Table(
        "Estimators, from first values that are wrong", tuple(columns), tuple(Row(tuple(r)) for r in lines), text=2
    )
    shown = {"title": "Estimators", "heading": "Cells and estimators", "table_of_groups": table, "figures": figures}
    lead = f"{len({row.cell for row in rows})} cells, {len(rows)} fits"
    path.write_text(fill("study.html", figures, lead=lead, facts=[], **shown), encoding="utf-8")


def _share_failed(rows: Sequence[MethodRow]) -> float:
    return 100.0 * float(np.mean([row.failed for row in rows]))


def _ratio_of_good(rows: Sequence[MethodRow]) -> float:
    good = [row.ratio for row in rows if not row.failed]
    return float(np.sqrt(np.mean(np.square(good)))) if good else float("nan")


def _time(rows: Sequence[MethodRow]) -> float:
    return float(np.median([row.seconds for row in rows]))


def _by_cell(
    rows: Sequence[MethodRow], title: str, quantity: str, of: Callable[[Sequence[MethodRow]], float]
) -> Figure:
    """Return a figure of a number for each cell and estimator."""
    cells = list(dict.fromkeys(row.cell for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    data: list[Trace] = []
    for i, method in enumerate(methods):
        values = []
        for cell in cells:
            own = [r for r in rows if r.cell == cell and r.method == method]
            values.append(of(own) if own else float("nan"))
        x = np.arange(len(cells)) + 0.12 * (i - 0.5 * (len(methods) - 1))
        symbol = ("disc", "diamond", "cross")[i // 3 % 3]
        texts = [f"{method}: {', '.join(cell)}" for cell in cells]
        data.append(plots.markers(x, np.array(values), method, "xyz"[i % 3], symbol=symbol, size=7, texts=texts))
    ticks = [list(range(len(cells))), [str(place + 1) for place in range(len(cells))]]
    x_axis = plots.axis("cell, in the table's order", range=[-0.5, len(cells) - 0.5], ticks=ticks)
    caption = "One mark for each estimator; the pointer shows the cell."
    return Figure(title.split()[0].lower(), title, caption, plots.plot(x_axis, plots.panel(data, plots.axis(quantity))))


def _scores(scores: list[tuple[str, list[float]]]) -> Figure:
    """Return the distribution of scores: share within so many standard deviations, with the normal one."""
    x = np.linspace(0.0, 4.0, 81)
    data: list[Trace] = []
    for i, (name, values) in enumerate(scores):
        ordered = np.sort(np.abs(values))
        share = np.searchsorted(ordered, x, side="right") / ordered.size
        curve = Curve(x.astype(np.float32), share.astype(np.float32))
        dash = ("", "dash", "dot")[i // 3 % 3]
        data.append(plots.line(curve, name, "xyz"[i % 3], dash=dash))
    # share of a normal variable within x, by numerical integration
    fine = np.linspace(0.0, 4.0, 4001)
    density = np.sqrt(2.0 / np.pi) * np.exp(-0.5 * fine**2)
    normal = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    data.append(plots.line(Curve(x.astype(np.float32), np.interp(x, fine, normal).astype(np.float32)), "expected",
                           "muted", width=2.0))  # fmt: skip
    return Figure(
        "scores",
        "Share of errors within so many standard deviations",
        "Good: every line follows the grey one. Above it standard deviations are too large, below it too small.",
        plots.simple(data, "standard deviations", "share of errors", height=360),
        shape="wide",
    )

"""A Monte-Carlo study on one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kreisel.report import plots
from kreisel.report.cells import Row, Table
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill
from kreisel.report.thinning import Curve


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

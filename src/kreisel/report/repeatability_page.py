"""Several calibrations of one device on one page: values with their deviations, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kreisel.calibration.repeatability import LEVEL, MAY_CHANGE, Repeated
from kreisel.calibration.result_sections import Measured
from kreisel.geometry.rotation import Array
from kreisel.report import plots
from kreisel.report.cells import Row, Table, pair
from kreisel.report.plots import Figure, Trace
from kreisel.report.template import fill

COLUMNS = ("quantity", "chi-square", f"{100 * LEVEL:.0f} % band", "largest score", "run", "x / xy", "y / xz", "z / yz")


def write_repeatability(found: Sequence[Repeated], runs: Sequence[str], facts: Sequence[str], path: Path) -> None:
    """Write the page of a comparison as one HTML file that works offline.

    Parameters
    ----------
    runs
        Names of the recordings.
    facts
        Sentences on all of them.
    """
    figures = [figure_of(one, runs) for one in found]
    lead = f"{len(runs)} recordings: {', '.join(runs)}"
    shown = {
        "title": "Repeatability",
        "lead": lead,
        "table_of_groups": table_of(found, runs),
        "facts": list(facts),
        "figures": figures,
    }
    page = fill("study.html", figures, **shown)
    path.write_text(page, encoding="utf-8")


def table_of(found: Sequence[Repeated], runs: Sequence[str]) -> Table:
    """Return the table of the differences between runs."""
    rows = tuple(Row(tuple(cells_of(one, runs)), weak=one.too_large) for one in found)
    return Table("Differences between runs over their standard deviations", COLUMNS, rows, text=1)


def cells_of(one: Repeated, runs: Sequence[str]) -> list[str]:
    """Return the cells of a quantity's row."""
    if np.isfinite(one.scores).any():
        worst = np.unravel_index(int(np.nanargmax(np.abs(one.scores))), one.scores.shape)
        largest, run = f"{one.scores[worst]:+.1f}", runs[int(worst[0])]
    else:
        largest, run = "-", "-"
    pairs = zip(one.mean.tolist(), (one.mean_sd * one.factor).tolist(), strict=True)
    mean = [pair(value, sd) if np.isfinite(sd) else "user-fixed" for value, sd in pairs]
    title = f"{one.title}, {one.unit}{' (may change)' if one.name in MAY_CHANGE else ''}"
    return [title, f"{one.chi_square:.2f}", f"{one.band[0]:.2f} to {one.band[1]:.2f}", largest, run, *mean]


def figure_of(one: Repeated, runs: Sequence[str], together: Measured | None = None) -> Figure:
    """Return a quantity in every run, and that of a calibration from all of them."""
    values, deviations, names = one.values, one.deviations, list(runs)
    if together is not None:
        values, deviations = np.vstack([values, together.value]), np.vstack([deviations, together.deviation])
        names.append("together")
    caption = f"Chi-square {one.chi_square:.2f}, expected {one.band[0]:.2f} to {one.band[1]:.2f}. Bars: one deviation."
    about = f"difference from the mean, {one.unit}"
    return bars(one.name, one.title, about, names, (values - one.mean, deviations), ("recording", caption))


def bars(
    name: str, title: str, quantity: str, places: Sequence[str], shown: tuple[Array, Array], words: tuple[str, str]
) -> Figure:
    """Return a figure of three numbers at several places, with bars of one deviation.

    Parameters
    ----------
    name, title, quantity
        Of the figure, and what stands at its y axis.
    places
        Names along the x axis.
    shown : (n, 3), (n, 3)
        Values and deviations.
    words
        What stands at the x axis, and the caption.
    """
    values, deviations = shown
    axes = ("xy", "xz", "yz") if "orthogonality" in name or "distances" in name else ("x", "y", "z")
    data: list[Trace] = []
    at = np.arange(len(places), dtype=float)
    for i, axis in enumerate(axes):
        x = at + 0.12 * (i - 1)
        data.append(plots.markers(x, values[:, i], axis, "xyz"[i], size=7, error=deviations[:, i]))
    most = max(5, min(12, 54 // len(places)))
    ticks = [at.tolist(), [_short(place, most) for place in places]]
    x_axis = plots.axis(words[0], range=[-0.5, len(places) - 0.5], ticks=ticks)
    y_axis = plots.axis(quantity, range=_room(values, deviations))
    return Figure(name, title, words[1], plots.plot(x_axis, plots.panel(data, y_axis)))


def _short(name: str, most: int) -> str:
    own = (most - 1) // 2
    return name if len(name) <= most else f"{name[:own]}…{name[-own:]}"


def _room(values: Array, deviations: Array) -> list[float]:
    """Return a range that holds all values with their bars."""
    low, high = np.nanmin(values - deviations, initial=0.0), np.nanmax(values + deviations, initial=0.0)
    room = 0.06 * (high - low) or 1.0
    return [float(low - room), float(high + room)]

"""The Allan deviation of a recording at rest on one page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.allan import TERMS, NoiseFigures
from kreisel.inertial.noise_figures import settings_table
from kreisel.preparation.resting_noise import UNITS, WORDS, AllanReport, filter_figures
from kreisel.report import plots
from kreisel.report.cells import Row, Table, pair
from kreisel.report.plots import Figure
from kreisel.report.template import fill
from kreisel.report.thinning import Curve

_DECADES = 3.0
"""Decades above which an axis has ticks at powers of ten alone."""

COLUMNS = ("sensor", "figure", "x", "y", "z", "unit")


def write_allan(title: str, found: AllanReport, path: Path) -> None:
    """Write the page as one HTML file that works offline."""
    figures = [_figure(sensor, one) for sensor, one in found.figures.items()]
    rows = tuple(Row((*row[:-1], _typeset(row[-1]))) for row in rows_of(found))
    table = settings_table(filter_figures(found)).replace("\n", "; ")
    shown = {
        "title": "Allan deviation",
        "kind": "readings at rest",
        "heading": "Noise figures",
        "lead": f"{title}: {found.seconds:.0f} s",
        "table_of_groups": Table("With deviations; - where the length shows none", COLUMNS, rows, text=2),
        "facts": [*found.remarks, f"For recording.toml: {table}"],
        "figures": figures,
    }
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def rows_of(found: AllanReport) -> list[list[str]]:
    """Return a row of cells for each sensor and figure."""
    out = []
    for sensor, one in found.figures.items():
        for term, (unit, size) in zip(TERMS, UNITS[sensor], strict=True):
            values = zip(getattr(one, term) / size, one.deviation[term] / size, one.shown[term], strict=True)
            out.append([sensor, WORDS[term], *(pair(v, sd) if known else "-" for v, sd, known in values), unit])
    return out


def _figure(sensor: str, one: NoiseFigures) -> Figure:
    """Return the curve of each axis; both axes of the figure are logarithms, with ticks at round values."""
    unit, size = UNITS[sensor][2]
    at, curve, fitted = np.log10(one.tau), _logarithms(one.curve / size), _logarithms(one.fitted / size)
    traces = []
    for i, axis in enumerate("xyz"):
        traces.append(plots.markers(at, curve[:, i], axis, axis, size=5))
        line = Curve(at.astype(np.float32), fitted[:, i].astype(np.float32))
        traces.append(plots.line(line, f"{axis}, by the figures", axis, legend=False))
    caption = "Points: overlapping Allan deviation. Lines: what the figures make of it."
    y = _axis(f"Allan deviation ({_typeset(unit)})", curve)
    return Figure(
        sensor, sensor.capitalize(), caption, plots.plot(_axis("averaging time (s)", at), plots.panel(traces, y))
    )


def _logarithms(values: Array) -> Array:
    return np.asarray(np.log10(np.maximum(values, 1e-300)))


def _axis(title: str, logarithms: Array) -> dict[str, Any]:
    low, high = float(np.min(logarithms)) - 0.15, float(np.max(logarithms)) + 0.15
    powers = np.arange(np.floor(low), np.ceil(high) + 1.0)
    values = np.outer(10.0**powers, [1.0] if high - low > _DECADES else [1.0, 2.0, 5.0]).ravel()
    shown = values[(np.log10(values) >= low) & (np.log10(values) <= high)]
    return plots.axis(title, range=[low, high], ticks=[np.log10(shown).tolist(), [f"{v:g}" for v in shown]])


def _typeset(unit: str) -> str:
    """Return a unit with its signs."""
    for plain, sign in (("sqrt(Hz)", "√Hz"), ("sqrt(h)", "√h"), ("sqrt(s)", "√s"), ("^2", "²")):
        unit = unit.replace(plain, sign)
    return re.sub(r"^u(?=rad|m|g)", "µ", unit)

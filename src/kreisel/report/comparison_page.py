"""Several estimators' calibrations of one recording on one page: values with their deviations, method by method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kreisel.calibration.by_method import GROUPS, ByMethod, differences, largest, scores
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.report.cells import Row, Table
from kreisel.report.plots import Figure
from kreisel.report.repeatability_page import bars
from kreisel.report.template import fill


def write_comparison(title: str, found: Sequence[ByMethod], truth: Mapping[str, float], path: Path) -> None:
    """Write the page of a comparison as one HTML file that works offline.

    Parameters
    ----------
    title
        Name of the recording.
    truth
        True values by the parameters' names; empty where they are not known.
    """
    done = [one for one in found if one.calibration is not None]
    figures = [_figure(place, done) for place in range(len(QUANTITIES))]
    rows = tuple(Row(tuple(row)) for row in rows_of(found, truth))
    shown = {
        "title": "Estimators side by side",
        "kind": "comparison",
        "heading": "Differences and drift",
        "lead": f"{title}: {', '.join(one.name for one in found)}",
        "table_of_groups": Table(_caption(found), columns_of(truth), rows, text=2),
        "facts": facts_of(found, truth),
        "figures": figures,
    }
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def columns_of(truth: Mapping[str, float]) -> tuple[str, ...]:
    """Return the names of the table's columns."""
    more = ("largest error", "error / sd") if truth else ()
    return ("estimator", "result", "s", "drift mm", "drift mrad", *GROUPS.values(), *more)


def rows_of(found: Sequence[ByMethod], truth: Mapping[str, float]) -> list[list[str]]:
    """Return a row of cells for each estimator."""
    first = next(one for one in found if one.calibration is not None)
    return [_cells(one, first, truth) for one in found]


def _cells(one: ByMethod, first: ByMethod, truth: Mapping[str, float]) -> list[str]:
    if one.calibration is None:
        return [one.name, "failed", f"{one.seconds:.1f}", *["-"] * (len(columns_of(truth)) - 3)]
    drift = ("-", "-") if one.drift is None else tuple(_number(1e3 * value) for value in one.drift)
    change = differences(one, first)
    apart = ["" if one is first else _number(largest(change, group)) for group in GROUPS]
    errors = scores(one, truth)
    more = []
    if truth:
        sizes = np.array(list(errors.values()))
        more = [_number(largest(errors, "")), _number(float(np.sqrt(np.mean(sizes**2))) if sizes.size else np.nan)]
    result = "accepted" if one.calibration.accepted else "rejected"
    return [one.name, result, f"{one.seconds:.1f}", *drift, *apart, *more]


def facts_of(found: Sequence[ByMethod], truth: Mapping[str, float]) -> list[str]:
    """Return sentences on all estimators together."""
    done = [one for one in found if one.calibration is not None]
    out = [f"{one.name} failed: {one.error}" for one in found if one.calibration is None]
    out += [
        f"{one.name} is rejected: {one.calibration.verdict.reasons[0]}"
        for one in done
        if one.calibration is not None and not one.calibration.accepted
    ]
    first = done[0]
    for one in done[1:]:
        change = differences(one, first)
        name = max(change, key=lambda parameter: abs(change[parameter]), default="")
        if name:
            size = f"{abs(change[name]):.2g} standard deviations ({name})"
            out.append(f"{one.name} differs from {first.name} by up to {size}.")
    out.append(
        "Differences are the largest of each group, in standard deviations of the first estimator. All use the same "
        "data: where the models are nearly linear they agree far better than that. Drift: root mean square of poses "
        "predicted from one to the next on data not used, with the calibration of the first part."
    )
    if truth:
        out.append("Errors are against truth.json, in each estimator's own standard deviations.")
    return out


def _caption(found: Sequence[ByMethod]) -> str:
    return f"{len(found)} estimators; differences from {found[0].name} in its standard deviations"


def _number(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _figure(place: int, done: Sequence[ByMethod]) -> Figure:
    """Return a quantity by every estimator."""
    quantity = QUANTITIES[place]
    measured = [one.calibration.derived[quantity.name] for one in done if one.calibration is not None]
    values, deviations = (np.array([getattr(one, part) for one in measured]) for part in ("value", "deviation"))
    names, about = [one.name for one in done], values.mean(axis=0)
    caption = "Difference from the mean of all estimators. Bars: one deviation."
    shown = (values - about, deviations)
    return bars(quantity.name, quantity.title, f"difference, {quantity.unit}", names, shown, ("estimator", caption))

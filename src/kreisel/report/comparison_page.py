"""Several estimators' calibrations of recordings on one page: values with their deviations, method by method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kreisel.calibration.by_method import (
    GROUPS,
    ByMethod,
    Comparison,
    differences,
    largest,
    over_expected,
    scores,
    too_sure,
)
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.repeatability import MAY_CHANGE, Repeated, quantities_compared
from kreisel.report.cells import Row, Table
from kreisel.report.plots import Figure
from kreisel.report.repeatability_page import bars
from kreisel.report.template import fill


def write_comparison(compared: Sequence[Comparison], runs: Sequence[str], path: Path) -> None:
    """Write the page of comparisons as one HTML file that works offline.

    Parameters
    ----------
    compared
        One for each recording.
    runs
        Names of the recordings.
    """
    figures = [_figure(place, compared, runs) for place in range(len(QUANTITIES))]
    rows = tuple(Row(tuple(row)) for row in rows_of(compared, runs))
    names = dict.fromkeys(one.name for comparison in compared for one in comparison.found)
    together = over_recordings(compared)
    shown = {
        "title": "Estimators side by side",
        "kind": "comparison",
        "heading": "Differences and drift",
        "lead": f"{', '.join(runs)}: {', '.join(names)}",
        "table_of_groups": Table(_caption(compared), columns_of(compared), rows, text=3 if len(compared) > 1 else 2),
        "further_tables": [_table_over_recordings(together)] if together else [],
        "facts": facts_of(compared, runs),
        "figures": figures,
    }
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def columns_of(compared: Sequence[Comparison]) -> tuple[str, ...]:
    """Return the names of the table's columns."""
    run = ("recording",) if len(compared) > 1 else ()
    more = ("largest error", "error / sd") if _known(compared) else ()
    return (
        *run,
        "estimator",
        "result",
        "s",
        "passes",
        "drift mm",
        "drift mrad",
        *GROUPS.values(),
        OVER_EXPECTED,
        *more,
    )


_TOO_SURE = 1.3
"""Deviations of another estimator over one's own, from which on it is said. Chosen: ours differ by 5 %."""

OVER_EXPECTED = "/ expected"
"""Column of differences over their expected deviations."""


def rows_of(compared: Sequence[Comparison], runs: Sequence[str]) -> list[list[str]]:
    """Return a row of cells for each recording and estimator."""
    known, several = _known(compared), len(compared) > 1
    return [
        [*([run] if several else []), *_cells(one, comparison, known=known)]
        for run, comparison in zip(runs, compared, strict=True)
        for one in comparison.found
    ]


def _known(compared: Sequence[Comparison]) -> bool:
    """Return whether there are true values of any recording."""
    return any(comparison.truth for comparison in compared)


def _cells(one: ByMethod, compared: Comparison, *, known: bool) -> list[str]:
    time = [f"{one.seconds:.1f}", f"{one.seconds / compared.unit:.0f}"]
    if one.error is not None:
        return [one.name, one.result, *time, *["-"] * (3 + len(GROUPS) + (2 if known else 0))]
    drift = ("-", "-") if one.drift is None else tuple(_number(1e3 * value) for value in one.drift)
    apart = [""] * (1 + len(GROUPS))
    if one is not compared.first:
        change = differences(one, compared.first)
        apart = [_number(largest(change, group)) for group in GROUPS]
        apart.append(_number(over_expected(one, compared.first)))
    errors = scores(one, compared.truth)
    more = []
    if known:
        sizes = np.array(list(errors.values()))
        more = [_number(largest(errors, "")), _number(float(np.sqrt(np.mean(sizes**2))) if sizes.size else np.nan)]
    return [one.name, one.result, *time, *drift, *apart, *more]


def facts_of(compared: Sequence[Comparison], runs: Sequence[str]) -> list[str]:
    """Return sentences on all estimators together."""
    out = []
    for run, comparison in zip(runs, compared, strict=True):
        begin = f"{run}: " if len(compared) > 1 else ""
        out += [begin + fact for fact in _facts(comparison)]
    out.append(
        "Differences are the largest of each group, in standard deviations of the first estimator. All use the same "
        "data: where the models are nearly linear they agree far better than that. An estimator that makes less of the "
        f'data differs by more, with the deviation sqrt(sd^2 - sd_first^2): "{OVER_EXPECTED}" is the rms of '
        'differences over it, about 1 if both are right, and "-" where deviations are nearly the same. Passes: the '
        "time, with all checks, over that of one strapdown pass. Drift: root mean square of poses predicted from one "
        "to the next on data not used, with the calibration of the first part."
    )
    if any(one.accepted is None and one.error is None for comparison in compared for one in comparison.found):
        out.append("Results of estimators that are not kreisel's are not judged.")
    if _known(compared):
        out.append("Errors are against truth.json, in each estimator's own standard deviations.")
    return out


def _facts(compared: Comparison) -> list[str]:
    out = [f"{one.name} failed: {one.error}" for one in compared.found if one.error is not None]
    out += [f"{one.name} is rejected: {one.reasons[0]}" for one in compared.done if one.reasons]
    for one in compared.done[1:]:
        times = too_sure(one, compared.first)
        if times > _TOO_SURE:
            out.append(
                f"{one.name} states deviations that are smaller than those of {compared.first.name}, a quarter of them "
                f"by {times:.2g} times or more, from the same data: one of the two is wrong about what it knows."
            )
        change = differences(one, compared.first)
        name = max(change, key=lambda parameter: abs(change[parameter]), default="")
        if name:
            size = f"{abs(change[name]):.2g} standard deviations ({name})"
            out.append(f"{one.name} differs from {compared.first.name} by up to {size}.")
    return out


def over_recordings(compared: Sequence[Comparison]) -> dict[str, list[Repeated]]:
    """Return how each estimator's results agree over the recordings, of those it has not rejected; by its name.

    Those with fewer than two results are left out.
    """
    results: dict[str, list[ByMethod]] = {}
    for comparison in compared:
        for one in comparison.done:
            if one.accepted is not False:
                results.setdefault(one.name, []).append(one)
    return {name: quantities_compared([one.derived for one in own]) for name, own in results.items() if len(own) > 1}


def chi_squares(together: dict[str, list[Repeated]]) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return columns and rows of the chi-square over the recordings: a row for each quantity."""
    names = list(together)
    rows = []
    for place, one in enumerate(together[names[0]]):
        title = f"{one.title}{' (may change)' if one.name in MAY_CHANGE else ''}"
        own = [together[name][place].chi_square for name in names]
        rows.append([title, *(_number(value) for value in own), f"{one.band[0]:.2f} to {one.band[1]:.2f}"])
    return ("quantity", *names, "99 % band"), rows


def _table_over_recordings(together: dict[str, list[Repeated]]) -> Table:
    columns, rows = chi_squares(together)
    return Table(
        "Chi-square per degree of freedom over the recordings", columns, tuple(Row(tuple(r)) for r in rows), text=1
    )


def _caption(compared: Sequence[Comparison]) -> str:
    first = compared[0]
    return f"{len(first.found)} estimators; differences from {first.first.name} in its standard deviations"


def _number(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _figure(place: int, compared: Sequence[Comparison], runs: Sequence[str]) -> Figure:
    """Return a quantity by every estimator, from every recording."""
    quantity = QUANTITIES[place]
    shown = [(run, one) for run, comparison in zip(runs, compared, strict=True) for one in comparison.done]
    measured = [one.derived[quantity.name] for _, one in shown]
    values, deviations = (np.array([getattr(one, part) for one in measured]) for part in ("value", "deviation"))
    several = len(compared) > 1
    names = [f"{run} {one.name}" if several else one.name for run, one in shown]
    known = np.isfinite(values)
    about = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    caption = "Difference from the mean of all. Bars: one deviation."
    words = ("recording and estimator" if several else "estimator", caption)
    return bars(
        quantity.name, quantity.title, f"difference, {quantity.unit}", names, (values - about, deviations), words
    )

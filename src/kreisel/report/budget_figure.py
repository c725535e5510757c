"""The budget of uncertainty as a picture: a bar for each group of parameters, divided by sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.outcome import Outcome
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.model.groups import group_named
from kreisel.report.cells import NOTHING, Row, Table, number

_MATRICES = ("gyro_cross_coupling", "accel_cross_coupling")
_SHOWN = 0.05
"""Per cent below which a share is written as a dash."""


@dataclass(frozen=True)
class Segment:
    """A source's part of a bar: which it is, from 0, its name, and its share in per cent."""

    index: int
    source: str
    percent: float


@dataclass(frozen=True)
class Bar:
    """A bar: symbol (HTML) and words for what it is about, rms standard deviation with its unit, segments."""

    symbol: str
    words: str
    deviation: str
    segments: tuple[Segment, ...]


@dataclass(frozen=True)
class BudgetPicture:
    """All bars, the sources that they show, and their table."""

    bars: tuple[Bar, ...]
    legend: tuple[Segment, ...]
    table: Table


def budget_picture(outcome: Outcome) -> BudgetPicture | None:
    """Return the budget of a calibration as a picture; None where it was not made."""
    budget = outcome.calibration.budget
    if budget is None:
        return None
    layout, bars = outcome.problem.layout, []
    for group in outcome.problem.groups:
        known, places = group_named(group), np.arange(layout[group].start, layout[group].stop)
        title = group.replace("_", " ")
        parts = {title: places}
        if group in _MATRICES:
            diagonal = layout.present(group) % 4 == 0
            parts = {f"{title}, diagonal": places[diagonal], f"{title}, other": places[~diagonal]}
        for words, own in parts.items():
            if budget.deviation[own].any():
                rms = float(np.sqrt(np.mean(budget.deviation[own] ** 2))) / known.size
                text = f"{number(rms, 2)} {known.unit}" if known.unit != "1" else number(rms, 2)
                bars.append(Bar(known.symbol, words, text, _segments(budget, own)))
    legend = tuple(Segment(i, str(source), 0.0) for i, source in enumerate(Source) if source in budget.by_source)
    return BudgetPicture(tuple(bars), legend, _table(budget))


def _segments(budget: Budget, places: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> tuple[Segment, ...]:
    """Return the shares of the sources in the variance of some parameters, on average."""
    shares = budget.by_source
    means = {i: 100.0 * float(np.mean(shares[s][places])) for i, s in enumerate(Source) if s in shares}
    return tuple(Segment(i, str(list(Source)[i]), percent) for i, percent in means.items() if percent >= _SHOWN)


def _table(budget: Budget) -> Table:
    """Return every parameter of IMU and cell with the per cent of its variance from each source."""
    shares, rows = budget.by_source, []
    for i, name in enumerate(budget.names):
        if name.startswith("robot."):
            continue  # hundreds, nearly all of the prior
        percents = [100.0 * float(values[i]) for values in shares.values()]
        cells = [f"{percent:.1f}" if percent >= _SHOWN else NOTHING for percent in percents]
        rows.append(Row((name, *cells)))
    return Table("Per cent of the variance, by source", ("Parameter", *map(str, shares)), tuple(rows))

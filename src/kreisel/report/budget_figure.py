"""The budget of uncertainty as a picture: a bar for each group of parameters, divided by sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.outcome import Outcome
from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.geometry.rotation import Indices
from kreisel.model.groups import group_named
from kreisel.report.cells import NOTHING, Row, Table, number
from kreisel.report.group_titles import SENSORS, TITLES
from kreisel.units import MRAD, PPM

_WORDS = {"lever_arms": "Positions of the accelerometers", "robot_placement": "Placements of the robot's joints"}
"""Of groups of several parameters, in the plural."""

_SHOWN = 0.05
"""Per cent below which a share is written as a dash."""


@dataclass(frozen=True)
class BudgetPart:
    """Parameters that share a bar: their words, group and places, their rms standard deviation (SI), and its unit."""

    words: str
    group: str
    places: Indices
    deviation: float
    unit: str
    size: float

    def text(self, deviation: float) -> str:
        """Return a standard deviation (SI) in the unit."""
        return f"{number(deviation / self.size, 2)}{'' if self.unit == '1' else f' {self.unit}'}"


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
    bars = []
    for part in parts_of(outcome):
        known = group_named(part.group)
        bars.append(Bar(known.symbol, part.words, part.text(part.deviation), _segments(budget, part.places)))
    legend = tuple(Segment(i, str(source), 0.0) for i, source in enumerate(Source) if source in budget.by_source)
    return BudgetPicture(tuple(bars), legend, _table(budget))


def parts_of(outcome: Outcome) -> list[BudgetPart]:
    """Return the groups of a calibration with a budget, matrices divided into scale factors and all else."""
    budget, layout, out = outcome.calibration.budget, outcome.problem.layout, []
    for group in () if budget is None else outcome.problem.groups:
        known, places = group_named(group), np.arange(layout[group].start, layout[group].stop)
        parts = [
            (
                _WORDS.get(group) or TITLES.get(group, group.replace("_", " ").capitalize()),
                places,
                known.unit,
                known.size,
            )
        ]
        if group in SENSORS:
            diagonal, name = layout.present(group) % 4 == 0, SENSORS[group]
            parts = [
                (f"{name} scale factors", places[diagonal], "ppm", PPM),
                (f"{name} misalignment, mounting", places[~diagonal], "mrad", MRAD),
            ]
        for words, own, unit, size in parts:
            if budget is not None and budget.deviation[own].any():
                rms = float(np.sqrt(np.mean(budget.deviation[own] ** 2)))
                out.append(BudgetPart(words, group, own, rms, unit, size))
    return out


def _segments(budget: Budget, places: Indices) -> tuple[Segment, ...]:
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

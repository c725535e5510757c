"""All units of a batch together: yield, table, and units that differ from the others of their lot."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO

import numpy as np

from kreisel.batch.job_result import Run
from kreisel.batch.outcomes import GOOD, OUTCOMES
from kreisel.calibration.data_sheet import QUANTITIES, Quantity
from kreisel.calibration.limits import Limits, QuantityDecision, judged, overall
from kreisel.estimation.robust import normal_scale
from kreisel.geometry.rotation import Array

_SIZES = (8, 9, 10, 12, 16, 20, 30, 50, 100, 300)
_OUTLYING = (12.3, 12.7, 10.0, 8.5, 7.2, 6.6, 5.7, 5.2, 4.9, 4.6)
"""Units of a lot, and robust standard deviations from its median beyond which one is an outlier.

Of normal units with 24 figures each, one lot in twenty has one by chance (60,000 units or more of each size were
drawn): few units do not show well how much they usually differ.
"""

MIN = 8
"""Units that a lot needs."""

OF_DEVICE = tuple(quantity for quantity in QUANTITIES if quantity.name != "mounting_rotation_deg")
"""Quantities that are the device's own, and not its mount's."""

PAGE_OF_TRAY = "../report.html"
"""The page of a tray, from the result folder of one of its units."""


@dataclass(frozen=True)
class Outlier:
    """A unit that differs from the others: which figure, and by how many robust standard deviations."""

    quantity: Quantity
    axis: int
    score: float

    @property
    def text(self) -> str:
        """The figure in words."""
        return f"{title_of(self.quantity, self.axis)}, {self.score:+.1f} deviations from the median"


@dataclass(frozen=True)
class Unit:
    """A run with what is said of it: its quantities against the limits, and where it differs from its lot."""

    run: Run
    judged: tuple[QuantityDecision, ...]
    outliers: tuple[Outlier, ...]

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`."""
        if self.run.parts is None:
            return "failed"
        if not self.run.accepted:
            return "rejected"
        decision = overall(self.judged)
        return "accepted" if decision is None else decision.value


def label_of(quantity: Quantity, axis: int) -> str:
    """Return the axis, or pair of axes, of one of three figures."""
    return (("x", "y", "z") if quantity.of == "axes" else ("xy", "xz", "yz"))[axis]


def title_of(quantity: Quantity, axis: int) -> str:
    """Return the words for one of three figures."""
    return f"{quantity.title} {label_of(quantity, axis)}"


def units_of(runs: Sequence[Run], limits: Limits | None) -> list[Unit]:
    """Return the runs judged by limits and against each other.

    A lot are the units of one maker and type, each by its last accepted run.
    """
    out = []
    lots: dict[tuple[str, str], list[Run]] = {}
    for run in last_of_each([run for run in runs if run.accepted]):
        lots.setdefault((run.maker, run.type), []).append(run)
    outliers = {key: found for lot in lots.values() for key, found in _outliers(lot).items()}
    for run in runs:
        own = () if run.parts is None else tuple(judged(run.parts, limits))
        out.append(Unit(run, own, tuple(outliers.get(run.key, ()))))
    return out


def last_of_each(runs: Sequence[Run]) -> list[Run]:
    """Return the last run of each device, in the order they were made."""
    last = {run.device: run for run in runs}
    return [run for run in runs if last[run.device] is run]


def pages_of(runs: Sequence[Run], *, reports: bool) -> dict[str, str]:
    """Return the pages that runs have, by key, as paths from their result folders.

    That of a unit of a tray is the page of the tray.

    Parameters
    ----------
    reports
        Whether each result of a recording of one unit has a report.
    """
    trays = {run.tray for run in runs if run.tray and run.text is not None}
    alone = {run.key: "report.html" for run in runs if not run.tray and run.text is not None and reports}
    return alone | {run.key: PAGE_OF_TRAY for run in runs if run.tray in trays}


def _outliers(lot: Sequence[Run]) -> dict[str, list[Outlier]]:
    """Return the outliers of a lot, by key, the largest first.

    The spread is the median of the absolute deviations from the median, times 1.4826; a unit's own deviation is added.
    """
    found: dict[str, list[Outlier]] = {}
    if len(lot) < MIN:
        return found
    for quantity in OF_DEVICE:
        values, deviations = figures_of(lot, quantity)
        for axis in range(3):
            here = np.flatnonzero(np.isfinite(values[:, axis]) & np.isfinite(deviations[:, axis]))
            if here.size < MIN:
                continue
            own = values[here, axis] - np.median(values[here, axis])
            spread = normal_scale(own)
            scores = own / np.maximum(np.hypot(spread, deviations[here, axis]), 1e-300)
            for i in np.flatnonzero(np.abs(scores) > outlying(here.size)):
                found.setdefault(lot[here[i]].key, []).append(Outlier(quantity, axis, float(scores[i])))
    return {key: sorted(own, key=lambda one: -abs(one.score)) for key, own in found.items()}


def outlying(count: int) -> float:
    """Return the robust standard deviations beyond which a unit is an outlier in a lot of this size."""
    return float(np.interp(np.log(count), np.log(_SIZES), _OUTLYING))


def figures_of(runs: Sequence[Run], quantity: Quantity) -> tuple[Array, Array]:
    """Return values and deviations (n, 3) of a quantity, not finite where a run has none."""
    values, deviations = np.full((len(runs), 3), np.nan), np.full((len(runs), 3), np.nan)
    for i, run in enumerate(runs):
        found = None if run.parts is None else run.parts.derived.get(quantity.name)
        if found is not None:
            values[i], deviations[i] = found.value, found.deviation
    return values, deviations


def devices(units: Sequence[Unit]) -> list[Unit]:
    """Return the units by their last runs: what was calibrated several times counts once."""
    last = {id(run) for run in last_of_each([unit.run for unit in units])}
    return [unit for unit in units if id(unit.run) in last]


def counts(units: Sequence[Unit]) -> dict[str, int]:
    """Return how many units have each outcome, of those that occur."""
    own = Counter(unit.outcome for unit in units)
    return {outcome: own[outcome] for outcome in OUTCOMES if own[outcome]}


def good(units: Sequence[Unit]) -> int:
    """Return how many units may be delivered: accepted, and within all limits where there are any."""
    return sum(unit.outcome in GOOD for unit in units)


def table(units: Sequence[Unit]) -> str:
    """Return the table of all units as CSV: values with every digit, and standard deviations."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    heads = [
        f"{quantity.name}.{label_of(quantity, axis)}{suffix}"
        for quantity in OF_DEVICE
        for axis in range(3)
        for suffix in ("", " sd")
    ]
    writer.writerow(["recording", "unit", "maker", "type", "date", "outcome", "verdict", "outliers", "error", *heads])
    for unit in units:
        run = unit.run
        cells: list[str] = []
        for quantity in OF_DEVICE:
            values, deviations = figures_of([run], quantity)
            for value, deviation in zip(values[0].tolist(), deviations[0].tolist(), strict=True):
                cells += ["" if np.isnan(x) else repr(x) for x in (value, deviation)]
        writer.writerow([
            run.name, run.unit, run.maker, run.type, run.date or "", unit.outcome, run.headline,
            "; ".join(one.text for one in unit.outliers), run.error or "", *cells,
        ])  # fmt: skip
    return out.getvalue()

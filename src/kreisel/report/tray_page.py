"""The units of a tray on one page: their places, their errors, and what their uncertainty comes from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from kreisel.array.tray_outcome import TrayOutcome, UnitOutcome
from kreisel.array.tray_result import OWN
from kreisel.calibration.data_sheet import OF_A_REFERENCE, QUANTITIES, Quantity
from kreisel.calibration.result_sections import Measured
from kreisel.geometry.rotation import Array
from kreisel.report import plots
from kreisel.report.cells import Row, Table, pair
from kreisel.report.places import places_figure, poses_table
from kreisel.report.plots import Figure
from kreisel.report.repeatability_page import bars
from kreisel.report.template import fill
from kreisel.units import PPM

COLUMNS = ("unit", "verdict", "serial number", "share of gyros, accelerometers", "clock, ppm")


def write_tray(outcome: TrayOutcome, path: Path) -> None:
    """Write the page of a tray as one HTML file that works offline."""
    figures = figures_of(outcome)
    units = outcome.units
    shown = {
        "title": "Tray of IMUs",
        "lead": f"{outcome.recording.name}: {len(units)} units, {sum(u.calibration.accepted for u in units)} accepted",
        "kind": "tray",
        "heading": "All units",
        "table_of_groups": units_table(outcome),
        "further_tables": [poses_table(outcome.reference, outcome.poses)],
        "facts": facts_of(outcome),
        "figures": figures,
    }
    path.write_text(fill("study.html", figures, **shown), encoding="utf-8")


def units_table(outcome: TrayOutcome) -> Table:
    """Return the table of verdicts."""
    rows = [
        Row(tuple(cells), weak=not unit.calibration.accepted)
        for unit, cells in zip(outcome.units, unit_rows(outcome), strict=True)
    ]
    rows += [Row((name, "not used", "", "", ""), weak=True) for name, _ in outcome.left_out]
    return Table("Units", COLUMNS, tuple(rows), text=3)


def unit_rows(outcome: TrayOutcome) -> list[list[str]]:
    """Return a row for each unit."""
    out = []
    for unit in outcome.units:
        facts = unit.calibration.recording
        serial = "" if facts is None else facts.device.get("serial_number", "")
        clock = outcome.clocks.get(unit.name)
        ratio = "-" if clock is None else pair(clock.skew / PPM, clock.skew_sd / PPM)
        share = f"{100.0 * unit.share[0]:.0f} %, {100.0 * unit.share[1]:.0f} %" if unit.share.any() else "none"
        out.append([unit.name, unit.calibration.verdict.headline.lower(), serial, share, ratio])
    return out


def facts_of(outcome: TrayOutcome) -> list[str]:
    """Return sentences on all units."""
    facts = [f"{name} is not used: {reason}" for name, reason in outcome.left_out]
    for unit in outcome.units:
        own = unit.calibration.verdict.reasons[len(outcome.mean.verdict.reasons) :]
        facts += [f"{unit.name}: {one}" for one in (*own, *(warning.message for warning in unit.warnings))]
    mean = outcome.mean.verdict
    if not mean.accepted:
        facts += [f"The mean of the units is rejected, and all units with it: {'; '.join(mean.reasons)}."]
    facts.append(
        f"The mean of the units has the noise of {outcome.gain[0]:.1f} units (gyros) and {outcome.gain[1]:.1f} "
        "(accelerometers). It was calibrated by the reference (mean/report.html); each unit by the mean's motion."
    )
    return facts


def figures_of(outcome: TrayOutcome) -> list[Figure]:
    """Return the figures."""
    figures = [places_figure(outcome.reference, outcome.poses)] if outcome.poses else []
    names = [unit.name for unit in outcome.units]
    for quantity in QUANTITIES:
        found = [unit.calibration.derived.get(quantity.name) for unit in outcome.units]
        known = [one for one in found if one is not None and np.isfinite(one.value).all()]
        if quantity.name not in OF_A_REFERENCE and len(known) == len(found):
            figures.append(_quantity(quantity, known, names))
    return [*figures, _own_share(outcome)]


def _quantity(quantity: Quantity, found: Sequence[Measured], names: Sequence[str]) -> Figure:
    values, sds = (np.array([getattr(one, what) for one in found]) for what in ("value", "deviation"))
    caption = "Bars: one standard deviation, most of it common to all units. Good: no unit far from the others."
    return bars(quantity.name, quantity.title, quantity.unit, list(names), (values, sds), ("unit", caption))


def _own_share(outcome: TrayOutcome) -> Figure:
    """Return what share of each unit's variance is its own."""
    parts: tuple[tuple[str, Callable[[str], bool]], ...] = (
        ("gyro matrix", lambda n: n.startswith("gyroscope.cross_coupling")),
        ("gyro offsets", lambda n: n.startswith("gyroscope.offset")),
        ("accelerometer matrix", lambda n: n.startswith("accelerometer.cross_coupling")),
        ("accelerometer offsets", lambda n: n.startswith("accelerometer.offset")),
        ("lever arms", lambda n: n.startswith("accelerometer.lever_arms")),
    )
    colours = ("x", "y", "z", "alert", "ink")
    at = np.arange(len(outcome.units), dtype=float)
    data = [
        plots.markers(
            at + 0.1 * (k - 2), np.array([_share(unit, own) for unit in outcome.units]), title, colours[k], size=7
        )
        for k, (title, own) in enumerate(parts)
    ]
    ticks = [at.tolist(), [unit.name for unit in outcome.units]]
    x_axis = plots.axis("unit", range=[-0.5, len(outcome.units) - 0.5], ticks=ticks)
    y_axis = plots.axis("own share of the variance", range=[0.0, 1.0])
    caption = (
        "How much of each unit's variance is its own noise; the rest, by the robot and the noise of the mean, is "
        "common to all units. Good: little."
    )
    return Figure("own-share", "Own share", caption, plots.plot(x_axis, plots.panel(data, y_axis)))


def _share(unit: UnitOutcome, own: Callable[[str], bool]) -> float:
    budget = unit.calibration.budget
    if budget is None:
        return float("nan")
    column = list(budget.causes).index(OWN)
    rows = [k for k, name in enumerate(budget.names) if own(name)]
    weights: Array = budget.deviation[rows] ** 2
    return float(np.sum(budget.shares[rows, column] * weights) / max(float(weights.sum()), 1e-300))

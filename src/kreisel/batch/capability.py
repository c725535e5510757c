"""How well a production keeps its limits: Cp and Cpk of every figure over the units of a batch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.batch.lot import MIN, OF_DEVICE, Unit, figures_of, last_of_each, title_of
from kreisel.calibration.data_sheet import Quantity
from kreisel.calibration.limits import Limits, limits_of
from kreisel.report.cells import Row, Table, number


@dataclass(frozen=True)
class Capability:
    """Capability of the production for one figure.

    Attributes
    ----------
    count
        Units.
    mean, sd
        Of the values, in the quantity's unit.
    calibration_sd
        Root mean square of the standard deviations of one calibration: its part of `sd`.
    cp, cpk
        Width of the limits over six standard deviations; distance of the mean from the nearer limit over three.
    cpk_interval
        95 % confidence interval of cpk.
    """

    quantity: Quantity
    axis: int
    limit: float
    count: int
    mean: float
    sd: float
    calibration_sd: float
    cp: float
    cpk: float
    cpk_interval: tuple[float, float]


def capabilities(units: Sequence[Unit], limits: Limits | None) -> list[Capability]:
    """Return the capability for every figure that has a limit, over units by their last accepted runs; eight at least.

    Notes
    -----
    Cpk with its interval by Bissell (1990), Applied Statistics 39, 331. Units that do not conform count too: they are
    of the same production.
    """
    runs, out = last_of_each([unit.run for unit in units if unit.run.accepted]), []
    for quantity in OF_DEVICE:
        most = limits_of(limits, quantity)
        values, deviations = figures_of(runs, quantity)
        for axis in np.flatnonzero(np.isfinite(most)).tolist():
            known = np.isfinite(values[:, axis]) & np.isfinite(deviations[:, axis])
            x, u, n = values[known, axis], deviations[known, axis], int(known.sum())
            if n < MIN or not np.ptp(x) > 0.0:
                continue
            mean, sd, limit = float(x.mean()), float(x.std(ddof=1)), float(most[axis])
            cp, cpk = limit / (3.0 * sd), (limit - abs(mean)) / (3.0 * sd)
            half = 1.96 * math.sqrt(1.0 / (9.0 * n) + cpk**2 / (2.0 * (n - 1)))
            own = math.sqrt(float(np.mean(u**2)))
            out.append(Capability(quantity, axis, limit, n, mean, sd, own, cp, cpk, (cpk - half, cpk + half)))
    return out


def capability_table(found: Sequence[Capability]) -> Table:
    """Return the capabilities as a table, the lowest Cpk first."""
    rows = [
        Row((
            title_of(one.quantity, one.axis), one.quantity.unit, f"± {number(one.limit)}",
            number(one.mean), number(one.sd), number(one.calibration_sd, 2), f"{one.cp:.2f}", f"{one.cpk:.2f}",
            f"{one.cpk_interval[0]:.2f} to {one.cpk_interval[1]:.2f}",
        ))
        for one in sorted(found, key=lambda one: one.cpk)
    ]  # fmt: skip
    columns = ("Figure", "Unit", "Limit", "Mean", "Deviation of units", "of which calibration", "Cp", "Cpk", "95 %")
    return Table("Capability", columns, tuple(rows), 2)

"""Several calibrations of one device compared: the test of uncertainties that needs no truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES, Quantity
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured
from kreisel.errors import SettingsError
from kreisel.estimation.consistency import normalised_bounds
from kreisel.geometry.rotation import Array
from kreisel.units import MM

LEVEL = 0.99
"""Probability of the band of chi-square, for each quantity."""

MAY_CHANGE = ("gyro_bias_deg_h", "accel_bias_mg", "mounting_rotation_deg")
"""Quantities that may truly differ: offsets after switching on again, and a mount that was loosened."""


_PARTS = ("value", "deviation")
"""Of a measured quantity."""


@dataclass(frozen=True)
class Repeated:
    """One quantity of three numbers in several calibrations.

    Attributes
    ----------
    name, title, unit
        As in the result file.
    values, deviations : (runs, 3)
        Deviations are 0 where a value was held.
    mean, mean_sd : (3,)
        Weighted by information; nan where no run estimated it.
    scores : (runs, 3)
        Differences from the mean of the other runs, over their deviations.
    chi_square
        Per degree of freedom, 1 expected; nan where it cannot be computed.
    band
        In which it lies with the probability `LEVEL` if deviations are right.
    """

    name: str
    title: str
    unit: str
    values: Array
    deviations: Array
    mean: Array
    mean_sd: Array
    scores: Array
    chi_square: float
    band: tuple[float, float]

    @property
    def too_large(self) -> bool:
        """Whether the runs differ by more than their deviations explain."""
        return self.chi_square > self.band[1]

    @property
    def factor(self) -> float:
        """By how much deviations would have to be multiplied for the differences to be usual; 1 at least."""
        return max(1.0, self.chi_square**0.5) if self.too_large else 1.0


def repeatability(calibrations: Sequence[Calibration]) -> tuple[Repeated, ...]:
    """Return the comparison of every quantity over calibrations of one device.

    Raises
    ------
    SettingsError
        For fewer than two calibrations.
    """
    if len(calibrations) < 2:
        raise SettingsError("give two or more recordings of one device")
    out = quantities_compared([c.derived for c in calibrations])
    for j, axis in enumerate("xyz"):
        arms = np.array([c.sensors.lever_arms[j] for c in calibrations]) / MM
        deviations = np.array([c.sensor_sd.lever_arms[j] for c in calibrations]) / MM
        out.append(_compared(f"lever_arm_{axis}_mm", f"Position of accelerometer {axis} in b", "mm", arms, deviations))
    return tuple(out)


def quantities_compared(
    derived: Sequence[Mapping[str, Measured]], chosen: Sequence[Quantity] = QUANTITIES
) -> list[Repeated]:
    """Return the comparison of quantities of data sheets over several calibrations."""
    return [
        _compared(
            q.name, q.title, q.unit, *(np.array([getattr(one[q.name], part) for one in derived]) for part in _PARTS)
        )
        for q in chosen
    ]


def _compared(name: str, title: str, unit: str, values: Array, deviations: Array) -> Repeated:
    known = deviations > 0.0
    weight = np.where(known, 1.0 / np.where(known, deviations, 1.0) ** 2, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, mean_sd = (weight * values).sum(axis=0) / total, total**-0.5
        rest = total - weight
        others = (total * mean - weight * values) / rest
        scores = np.where(known & (rest > 0.0), (values - others) / np.hypot(deviations, rest**-0.5), np.nan)
    runs = known.sum(axis=0)
    degrees = int(np.sum(np.maximum(runs - 1, 0)))
    chi_square = float(np.nansum(weight * (values - mean) ** 2)) / degrees if degrees else float("nan")
    band = normalised_bounds(np.array([degrees]), LEVEL) if degrees else (float("nan"), float("nan"))
    return Repeated(name, title, unit, values, deviations, mean, mean_sd, scores, chi_square, band)

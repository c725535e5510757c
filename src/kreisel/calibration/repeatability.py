"""Several calibrations of one device compared: the test of uncertainties that needs no truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.calibration.data_sheet import QUANTITIES, Quantity, derive
from kreisel.calibration.device_axes import NAMES, expressed, vector_of, with_vector
from kreisel.calibration.linear_errors import LINEAR_ERRORS
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Measured
from kreisel.errors import SettingsError
from kreisel.estimation.consistency import normalised_bounds
from kreisel.estimation.uncertainty_budget import Source
from kreisel.geometry.rotation import Array
from kreisel.units import MM

LEVEL = 0.99
"""Probability of the band of chi-square, for each quantity."""

MAY_CHANGE = ("gyro_bias_deg_h", "accel_bias_mg", "mounting_rotation_deg")
"""Quantities that may truly differ: offsets after switching on again, and a mount that was loosened."""

_COMMON = (Source.PRIOR, Source.ROBOT)
"""Sources of errors that runs in one place have in common; the reference's linear errors are another. Chosen: gravity
and the robot's frames are the same in every run; more runs do not reduce them."""

_LEVER_ARMS = "lever arms"
"""Name of the common part of their deviations."""

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
        Weighted by information; nan where no run estimated it. What all runs have in common is not reduced.
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
        For fewer than two calibrations, or those of several devices.
    """
    if len(calibrations) < 2:
        raise SettingsError("give two or more recordings of one device")
    numbers = sorted({one.recording.device.get("serial_number", "") for one in calibrations if one.recording} - {""})
    if len(numbers) > 1:
        raise SettingsError(
            f"the recordings state {len(numbers)} serial numbers: {', '.join(numbers)}; give those of one device, or "
            "correct [device] serial_number in recording.toml"
        )
    digests = [one.recording.digest for one in calibrations if one.recording is not None and one.recording.digest]
    if len(set(digests)) < len(digests):
        raise SettingsError("two of the results are of the same data, which count once: give each recording once")
    common = [_common_deviations(one) for one in calibrations]
    out = quantities_compared([c.derived for c in calibrations], common=common)
    shared = np.array([one.get(_LEVER_ARMS, np.zeros((3, 3))) for one in common]) / MM
    for j, axis in enumerate("xyz"):
        arms = np.array([c.sensors.lever_arms[j] for c in calibrations]) / MM
        deviations = np.array([c.sensor_sd.lever_arms[j] for c in calibrations]) / MM
        name, title = f"lever_arm_{axis}_mm", f"Position of accelerometer {axis} in b"
        out.append(_compared(name, title, "mm", (arms, deviations, shared[:, j])))
    return tuple(out)


def quantities_compared(
    derived: Sequence[Mapping[str, Measured]],
    chosen: Sequence[Quantity] = QUANTITIES,
    common: Sequence[Mapping[str, Array]] = (),
) -> list[Repeated]:
    """Return the comparison of quantities of data sheets over several calibrations.

    Parameters
    ----------
    common
        Parts of the deviations that all calibrations have in common, (3,) by quantity; none where missing.
    """
    out = []
    for q in chosen:
        values, deviations = (np.array([getattr(one[q.name], part) for one in derived]) for part in _PARTS)
        shared = np.array([one.get(q.name, np.zeros(3)) for one in common or [{}] * len(derived)])
        out.append(_compared(q.name, q.title, q.unit, (values, deviations, shared)))
    return out


def _common_deviations(one: Calibration) -> dict[str, Array]:
    """Return the part of deviations that is the same error in every run, by quantity; empty without a budget.

    A parameter's correlations are taken to be those of its whole error.
    """
    if one.budget is None or one.axes != "tool":
        return {}
    causes = one.budget.causes.items()
    shared = [i for i, (name, source) in enumerate(causes) if source in _COMMON or name == LINEAR_ERRORS]
    share = dict(zip(one.budget.names, np.sqrt(one.budget.shares[:, shared].sum(axis=1)), strict=True))
    part = np.array([share.get(name, 0.0) for name in one.names])
    if not part.any():
        return {}
    covariance = part[:, None] * one.covariance * part
    deviation = with_vector(one.sensor_sd, vector_of(one.sensor_sd) * np.array([share.get(n, 0.0) for n in NAMES]))
    found, _, P, unpack = expressed(one.sensors, deviation, one.names, covariance, "tool")
    out = {name: measured.deviation for name, measured in derive(found.sensors, P, unpack).items()}
    return out | {_LEVER_ARMS: deviation.lever_arms}


def _compared(name: str, title: str, unit: str, measured: tuple[Array, Array, Array]) -> Repeated:
    """Return the comparison of values (runs, 3) with their deviations and what all runs have in common of these."""
    values, deviations, common = measured
    known = deviations > 0.0
    spread, common = np.where(known, deviations, 0.0), np.where(known, common, 0.0)
    weight = np.where(known, 1.0 / np.where(known, deviations, 1.0) ** 2, 0.0)
    total = weight.sum(axis=0)
    weighted = np.where(known, weight * values, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = weighted.sum(axis=0) / total
        own = np.maximum(spread**2 - common**2, 0.0)
        mean_sd = np.sqrt((weight**2 * own).sum(axis=0) + (weight * common).sum(axis=0) ** 2) / total
        rest = total - weight
        others = (total * mean - weighted) / rest
        scores = np.where(known & (rest > 0.0), (values - others) / np.hypot(deviations, rest**-0.5), np.nan)
    runs = known.sum(axis=0)
    degrees = int(np.sum(np.maximum(runs - 1, 0)))
    chi_square = float(np.nansum(weight * (values - mean) ** 2)) / degrees if degrees else float("nan")
    band = normalised_bounds(np.array([degrees]), LEVEL) if degrees else (float("nan"), float("nan"))
    return Repeated(name, title, unit, values, deviations, mean, mean_sd, scores, chi_square, band)

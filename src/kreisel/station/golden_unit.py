"""The check of a station by a unit that is known: it must find what was found before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.batch.lot import title_of
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.repeatability import MAY_CHANGE
from kreisel.calibration.result_sections import CalibrationParts

SCORE = 3.5
"""Deviations of a difference beyond which a figure does not agree; by chance one of 18 does not in 1 of 120 checks."""


@dataclass(frozen=True)
class GoldenCheck:
    """What became of the known unit: the figures that differ, a sentence each, and the largest score."""

    reasons: tuple[str, ...]
    worst: float

    @property
    def passed(self) -> bool:
        """Whether the station finds what it found before."""
        return not self.reasons


def golden_check(reference: CalibrationParts, found: CalibrationParts) -> GoldenCheck:
    """Return how a calibration of the known unit differs from its reference.

    Offsets and the mount may change when a device is switched on or clamped again, and are not compared.
    """
    if not found.verdict.accepted:
        return GoldenCheck(("the known unit was rejected: " + found.verdict.reasons[0],), float("inf"))
    reasons, worst = [], 0.0
    for quantity in QUANTITIES:
        old, new = reference.derived.get(quantity.name), found.derived.get(quantity.name)
        if quantity.name in MAY_CHANGE or old is None or new is None:
            continue
        sd = np.hypot(old.deviation, new.deviation)
        with np.errstate(divide="ignore", invalid="ignore"):
            scores = np.where(sd > 0.0, (new.value - old.value) / sd, 0.0)
        worst = max(worst, float(np.nanmax(np.abs(scores))))
        reasons += [
            f"{title_of(quantity, axis)}: {new.value[axis]:.4g} {quantity.unit}, known as "
            f"{old.value[axis]:.4g}: {scores[axis]:+.1f} deviations"
            for axis in np.flatnonzero(np.abs(scores) > SCORE).tolist()
        ]
    return GoldenCheck(tuple(reasons), worst)

"""Comparison of a calibration with the truth of a simulated cell, group by group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array
from kreisel.simulation.cell import Truth
from kreisel.units import DEG_PER_HOUR, MG


@dataclass(frozen=True)
class GroupError:
    """Errors of a group of parameters and the calibration's standard deviations of them, SI.

    Attributes
    ----------
    title, unit, factor
        Title of the group, the unit it is shown in, and that unit's inverse.
    error, deviation
        Arrays of the same shape.
    """

    title: str
    unit: str
    factor: float
    error: Array
    deviation: Array

    @property
    def size(self) -> float:
        """Rms error, in `unit`."""
        return self.factor * float(np.sqrt(np.mean(self.error**2)))

    @property
    def expected(self) -> float:
        """Rms standard deviation, in `unit`."""
        return self.factor * float(np.sqrt(np.mean(self.deviation**2)))

    @property
    def ratio(self) -> float:
        """Rms of error over standard deviation; 1 is expected."""
        known = self.deviation > 0.0
        return float(np.sqrt(np.mean((self.error[known] / self.deviation[known]) ** 2))) if known.any() else np.nan


def group_errors(calibration: Calibration, truth: Truth) -> dict[str, GroupError]:
    """Return the errors of every group."""
    found, sd, true = calibration.sensors, calibration.sensor_sd, truth.sensors
    gravity = calibration.alignment.gravity
    down = truth.gravity_r / np.linalg.norm(truth.gravity_r)
    across = np.linalg.svd(down[None])[2][1:]  # two directions across gravity
    size = float(np.linalg.norm(truth.gravity_r))
    rows = {
        "gyro_cross_coupling": (
            "gyro cross-coupling", "ppm", 1e6, found.K_omega - true.K_omega, sd.K_omega,
        ),
        "gyro_offset": ("gyro offset", "deg/h", 1.0 / DEG_PER_HOUR, found.k_w[0] - true.k_w[0], sd.k_w[0]),
        "accel_cross_coupling": (
            "accelerometer cross-coupling", "ppm", 1e6, found.K_a - true.K_a, sd.K_a,
        ),
        "accel_offset": ("accelerometer offset", "mg", 1.0 / MG, found.k_a[0] - true.k_a[0], sd.k_a[0]),
        "lever_arms": ("lever arms", "mm", 1e3, found.lever_arms - true.lever_arms, sd.lever_arms),
        "alignment": (
            "gravity's direction", "urad", 1e6, across @ gravity.value / size,
            np.sqrt((across**2) @ gravity.deviation**2) / size,
        ),
        "time_offset": (
            "time offset", "ms", 1e3,
            np.array([calibration.timing.offset - truth.time_offset]), [calibration.timing.offset_sd],
        ),
    }  # fmt: skip
    return {
        group: GroupError(title, unit, factor, np.asarray(error), np.array(deviation, dtype=float))
        for group, (title, unit, factor, error, deviation) in rows.items()
    }

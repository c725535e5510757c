"""Noise of inertial sensors: grades of devices, and noise densities found in a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.units import DEG_PER_HOUR, DEG_PER_ROOT_HOUR, MG


@dataclass(frozen=True)
class Grade:
    """Noise and offset of a class of devices, SI (densities per root hertz); `source` for each number."""

    gyro_noise_density: float
    accel_noise_density: float
    gyro_offset_sd: float
    accel_offset_sd: float
    source: str


GRADES = {
    "ring-laser": Grade(
        0.0035 * DEG_PER_ROOT_HOUR,
        0.02 * MG,
        0.03 * DEG_PER_HOUR,
        0.1 * MG,
        "offsets: Fox and Janocha (2005), table 1, LPA; gyro noise: GG1320 class, assumed; "
        "accelerometer noise: QA-2000 class, assumed",
    ),
    "fog": Grade(
        0.02 * DEG_PER_ROOT_HOUR,
        0.02 * MG,
        1.0 * DEG_PER_HOUR,
        1.0 * MG,
        "offsets: Fox and Janocha (2005), table 1, iNAV-FMS; noise: assumed",
    ),
    "fog-mems": Grade(
        0.15 * DEG_PER_ROOT_HOUR,
        0.1 * MG,
        20.0 * DEG_PER_HOUR,
        25.0 * MG,
        "offsets: Fox and Janocha (2005), table 1, iVRU-FC; noise: assumed",
    ),
    "industrial-mems": Grade(
        0.3 * DEG_PER_ROOT_HOUR, 0.1 * MG, 400.0 * DEG_PER_HOUR, 10.0 * MG, "assumed, typical data sheets"
    ),
    "consumer-mems": Grade(
        0.6 * DEG_PER_ROOT_HOUR, 0.3 * MG, 3600.0 * DEG_PER_HOUR, 60.0 * MG, "assumed, typical data sheets"
    ),
}
"""Presets for `recording.toml`'s ``grade``."""


def high_frequency_density(values: Array, interval: float) -> Array:
    """Return the noise density (3,) of sampled signals (n, 3) as it shows in their third differences.

    White noise of variance s^2 has third differences of variance 20 s^2; a smooth motion leaves next to
    nothing in them. The median of the squares keeps shocks out.

    Parameters
    ----------
    values
        Readings, in their unit.
    interval
        Time between two samples, s.
    """
    third = np.diff(values, n=3, axis=0)
    # the median of a chi-square variable with one degree of freedom
    variance = np.median(third**2, axis=0) / (20.0 * 0.454936)
    return np.asarray(np.sqrt(variance * interval))

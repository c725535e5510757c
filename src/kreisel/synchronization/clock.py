"""Relation of the reference's clock to the IMU's."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.geometry.rotation import Array

MAX_SKEW = 0.022
"""Largest clock ratio, less one, that is searched. Stamps by timers of microcontrollers were up to 1.6 per cent off in
recordings of one arm; crystals are within 0.01."""


@dataclass(frozen=True)
class Clock:
    """``t_imu = start + (1 + skew) * tau``.

    t_imu counts seconds from the first IMU sample, tau from the first reference pose: both are small
    numbers whatever the stamps are.

    Attributes
    ----------
    start, skew
        s and 1.
    start_sd, skew_sd
        Their standard deviations.
    """

    start: float
    skew: float = 0.0
    start_sd: float = 0.0
    skew_sd: float = 0.0

    def imu_time(self, tau: Array) -> Array:
        """Return the IMU's seconds for reference seconds tau."""
        return self.start + (1.0 + self.skew) * tau  # equation (11)

    def reference_time(self, t: Array) -> Array:
        """Return the reference's seconds for IMU seconds t."""
        return (t - self.start) / (1.0 + self.skew)

    def distance(self, other: Clock, tau: Array) -> float:
        """Return the largest difference of two clocks' IMU times over reference seconds tau, s."""
        ends = tau[[0, -1]]
        return float(max(abs(self.imu_time(ends) - other.imu_time(ends))))

    def offset(self, first_imu_ns: int, first_reference_ns: int) -> float:
        """Return the time offset of the result file: t_imu = t_ref + offset + skew (t_ref - first t_ref), s."""
        return self.start + (first_imu_ns - first_reference_ns) * 1e-9

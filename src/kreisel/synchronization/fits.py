"""Results of synchronisation: the clocks, and the fit of the gyros to the reference's rotations."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.synchronization.clock import Clock


@dataclass(frozen=True)
class Correlation:
    """Result of the correlation.

    Attributes
    ----------
    clock
    coefficient
        Correlation coefficient over the whole overlap.
    periods
        Shifts of that clock, s, by which the two correlate as well: the motion repeats itself.
    """

    clock: Clock
    coefficient: float
    periods: tuple[float, ...] = ()


@dataclass(frozen=True)
class RateFit:
    """Gyro parameters and clock that bring integrated readings onto the reference's rotations.

    Attributes
    ----------
    K_omega : (3, 3)
    k_w0 : (3,)
        rad/s.
    clock
        With the standard deviations of the fit.
    skewed
        Whether the ratio of the clocks is estimated: always with orientations, and without where positions show it.
    explained
        Share of the reference's squared rotation that the fit explains; 1 is all.
    residual_sd
        Standard deviation of the residual of a rotation, rad, each axis.
    K_omega_sd, k_w0_sd : (3, 3), (3,)
        Standard deviations of the fit.
    clock_drift : (k, 3)
        Residual clock drift in parts of the recording: reference seconds of the middle, shift, its standard
        deviation. It is only noise where both clocks run steadily.
    """

    K_omega: Array
    k_w0: Array
    clock: Clock
    skewed: bool
    explained: float
    residual_sd: float
    K_omega_sd: Array
    k_w0_sd: Array
    clock_drift: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def rate_at_zero(self) -> Array:
        """The corrected rate where the gyros read zero, K_omega k_w0, rad/s."""
        return self.K_omega @ self.k_w0

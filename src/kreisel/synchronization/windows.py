"""Second differences of positions, and double integrals of readings over the same windows.

The second difference of positions over half a second, divided by the half length squared, equals the mean acceleration
with a triangular weight. So does the second difference of the double integral of accelerations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel._kernels import quadrature
from kreisel.geometry.interpolation import interpolate_columns, nearest, running_mean
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.inertial.strapdown import InertialSignal
from kreisel.synchronization.clock import Clock

HALF_WINDOW = 0.25
"""Half the length of a second difference, s."""

_SMOOTHED = 0.1  # s over which positions are averaged; chosen: less than half of the shortest window's half
_NEAR_GAP = 1.0  # s; the attitude is smoothed over a second (`preparation.attitude`)


@dataclass(frozen=True)
class Windows:
    """Second differences at evenly spread poses, divided by their half length (IMU seconds) squared.

    Attributes
    ----------
    stamps : (n,)
        IMU seconds of the readings.
    t, tau
        Beginning, middle and end of the windows, (w,) each, in IMU and in reference seconds.
    reference : (m,)
        Reference seconds of the poses.
    half
        Half their length, IMU seconds.
    """

    stamps: Array
    t: tuple[Array, Array, Array]
    tau: tuple[Array, Array, Array]
    reference: Array
    half: float

    @classmethod
    def over(cls, signal: InertialSignal, clock: Clock, tau: Array, shortest: float = HALF_WINDOW) -> Windows:
        """Return windows that lie inside both recordings."""
        half = _half(tau, shortest)
        low = max(tau[0] + half, float(clock.reference_time(signal.stamps[1])) + half)
        high = min(tau[-1] - half, float(clock.reference_time(signal.stamps[-2])) - half)
        middle = np.arange(low, high, 0.4 * half)
        if half > shortest:  # between poses far apart, positions on straight lines have less curvature than the motion
            middle = np.unique(tau[nearest(tau, middle)])
            middle = middle[(middle >= low) & (middle <= high)]
        middle = middle[_without_gaps(signal, clock, tau, middle, half)]
        at = (middle - half, middle, middle + half)
        t = tuple(clock.imu_time(s) for s in at)
        return cls(signal.stamps, t, at, tau, half * (1.0 + clock.skew))  # type: ignore[arg-type]

    def second_difference(self, p: Array) -> Array:
        """Second difference of positions, smoothed over the poses near each end, (windows, 3)."""
        width = _smoothed(self.reference)
        smooth = running_mean(p, width) if width > 1 else p
        a, b, c = (interpolate_columns(s, self.reference, smooth) for s in self.tau)
        return np.asarray((a - 2.0 * b + c) / self.half**2)

    def integrate(self, values: Array) -> Array:
        """Triangularly weighted mean of sampled values (n, k), (windows, k)."""
        values = np.ascontiguousarray(values)
        return self.means(values.shape[1], lambda *at: quadrature.double_integral(self.stamps, values, *at))

    def means(self, columns: int, integrate: Callable[[Indices, Array, Array], None]) -> Array:
        """Return triangularly weighted means, (windows, columns), of the quantity that `integrate` integrates twice.

        Parameters
        ----------
        integrate
            Write the double integral (m, columns) to moments: see `_kernels.quadrature.double_integral`.
        """
        moments = np.concatenate(self.t)
        order = np.argsort(moments, kind="stable")
        moments = moments[order]
        before = np.clip(np.searchsorted(self.stamps, moments, side="right") - 1, 0, self.stamps.size - 2)
        share = (moments - self.stamps[before]) / (self.stamps[before + 1] - self.stamps[before])
        ordered, integral = np.empty((moments.size, columns)), np.empty((moments.size, columns))
        integrate(before, share, ordered)
        integral[order] = ordered
        a, b, c = np.split(integral, 3)
        return np.asarray((a - 2.0 * b + c) / self.half**2)


def variance_by_noise(tau: Array, sd: float) -> float:
    """Return the variance that white noise of positions at times tau (m,) adds to a second difference, m^2/s^4."""
    return 6.0 * sd**2 / (_smoothed(tau) * _half(tau, HALF_WINDOW) ** 4)


def _half(tau: Array, shortest: float) -> float:
    """Return half the length of windows, s: three poses or more."""
    return max(shortest, 3.0 * float(np.median(np.diff(tau))))


def _smoothed(tau: Array) -> int:
    """Return the number of poses over which positions are averaged; 1 where these are too far apart."""
    width = round(_SMOOTHED / float(np.median(np.diff(tau))))
    return width if width > 2 else 1


def _without_gaps(signal: InertialSignal, clock: Clock, tau: Array, middle: Array, half: float) -> Mask:
    """Return which windows have all samples, lie at some distance from gaps, and have poses near their ends.

    The attitude is smoothed over a second, so that near a gap it is not known well.
    """
    starts, stops = (signal.stamps[np.array(ends)] for ends in zip(*signal.segments, strict=True))
    starts[1:] += _NEAR_GAP
    stops[:-1] -= _NEAR_GAP
    first, last = clock.imu_time(middle - half), clock.imu_time(middle + half)
    segment = np.clip(np.searchsorted(starts, first, side="right") - 1, 0, starts.size - 1)
    known = (first >= starts[segment]) & (last <= stops[segment])
    steps = np.diff(tau)
    for at in (middle - half, middle, middle + half):
        k = np.clip(np.searchsorted(tau, at) - 1, 0, steps.size - 1)
        known &= steps[k] < 6.0 * float(np.median(steps))
    return np.asarray(known)

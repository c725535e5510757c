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

_SMOOTHED = 0.1  # s over which positions are smoothed; chosen: less than half of the shortest window's half
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
        half, edge = _half(tau, shortest), _Smoothing.of(tau).outer
        low = max(tau[min(edge, tau.size - 1)], float(clock.reference_time(signal.stamps[1]))) + half
        high = min(tau[max(tau.size - 1 - edge, 0)], float(clock.reference_time(signal.stamps[-2]))) - half
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
        smooth = _Smoothing.of(self.reference).applied(p)
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
    return 6.0 * sd**2 * _Smoothing.of(tau).variance / _half(tau, HALF_WINDOW) ** 4


@dataclass(frozen=True)
class _Smoothing:
    """Means over poses on both sides, with weights that leave parabolas as they are.

    A mean over W seconds makes a motion of frequency f smaller by (pi f W)^2 / 6: 6 % of one of 2 Hz over 0.1 s.

    Attributes
    ----------
    inner, outer
        Poses on either side of a shorter and a longer mean.
    share
        How much of their difference is added to the shorter one.
    """

    inner: int
    outer: int
    share: float

    @classmethod
    def of(cls, tau: Array) -> _Smoothing:
        """Return the smoothing of poses at times (m,); none where they are too far apart."""
        outer = round(0.5 * _SMOOTHED / float(np.median(np.diff(tau))))
        inner = outer // 2
        squares = [(2.0 * half + 1.0) ** 2 - 1.0 for half in (inner, outer)]
        return cls(inner, outer, squares[0] / (squares[1] - squares[0])) if inner else cls(0, 0, 0.0)

    def applied(self, p: Array) -> Array:
        """Return positions (m, 3) smoothed; those at the ends of the recording are not."""
        if not self.outer:
            return p
        short, long = (running_mean(p, 2 * half) for half in (self.inner, self.outer))
        return short + self.share * (short - long)

    @property
    def variance(self) -> float:
        """Variance of white noise after it, over that before it."""
        short, long = (1.0 / (2.0 * half + 1.0) for half in (self.inner, self.outer))
        return (1.0 + self.share) ** 2 * short - self.share * (2.0 + self.share) * long


def _half(tau: Array, shortest: float) -> float:
    """Return half the length of windows, s: three poses or more."""
    return max(shortest, 3.0 * float(np.median(np.diff(tau))))


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

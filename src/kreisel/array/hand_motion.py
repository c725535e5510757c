"""Readings of several IMUs that were turned and shaken as one body, on one clock and in the axes of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kreisel.array.clock_refinement import refined_clock
from kreisel.array.resampled import resampled, white_noise
from kreisel.array.sudden_change import SuddenChange, sudden_change
from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Mask, lengths, nearest_rotation, skew
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.slopes import local_cubics, usual_interval
from kreisel.recording.recording import ImuSamples
from kreisel.synchronization.clock import Clock

_MOVING = 0.05
"""Share of the 99th percentile of the rate above which a sample is used. Chosen: slower ones say a 400th as much of
positions."""

_MOST = 60_000
"""Samples that are used at most, evenly chosen. Chosen: an estimate takes a minute then."""

_FEWEST = 200
"""Samples in motion below which nothing is estimated."""


@dataclass(frozen=True)
class HandMotion:
    """Corrected readings of N IMUs at n samples in motion.

    Attributes
    ----------
    seconds : (n,)
        On the clock of the first IMU.
    rates, forces : (N, n, 3)
        rad/s in the axes of the first IMU; m/s^2 in each one's own.
    force_slopes : (N, n, 3)
        Derivatives of the forces.
    axes : (N, 3, 3)
        Turn vectors of an IMU's axes into those of the first.
    slope, bend, curvature : (n, 3), (n, 3), (n, 3, 3)
        First and second derivative of the mean rate w, and the second one of [w x]^2, by cubics.
    slope_deviation : (n,)
        Of the derivative, rad/s^2: by noise, and by what a cubic through seven samples leaves out.
    clocks
        Of each IMU against the first.
    change
        The clearest sudden change of an IMU, if there is one.
    """

    seconds: Array
    rates: Array
    forces: Array
    force_slopes: Array
    axes: Array
    slope: Array
    bend: Array
    curvature: Array
    slope_deviation: Array
    clocks: tuple[Clock, ...]
    change: SuddenChange | None = None

    @cached_property
    def mean(self) -> Array:
        """Mean rate, (n, 3)."""
        return np.asarray(self.rates.mean(axis=0))

    @cached_property
    def by_place(self) -> Array:
        """Force by a unit of distance, (n, 3, 3), 1/s^2: [w' x] + [w x]^2."""
        return np.asarray(skew(self.slope) + skew(self.mean) @ skew(self.mean))

    def in_common(self, vectors: Array) -> Array:
        """Return vectors (N, n, 3), each IMU's in its own axes, in the axes of the first."""
        return np.asarray(vectors @ np.swapaxes(self.axes, 1, 2))

    def in_axes(self, vectors: Array) -> Array:
        """Return vectors (m, 3) in the axes of each IMU, (N, m, 3)."""
        return np.asarray(vectors @ self.axes)


def corrected_readings(imu: ImuSamples, sensors: SensorParameters) -> ImuSamples:
    """Return readings with offset and matrix applied."""
    rates = (imu.rates + sensors.k_w[0]) @ sensors.K_omega.T
    return ImuSamples(
        imu.stamps_ns, rates, (imu.accelerations + sensors.k_a[0]) @ sensors.K_a.T, imu.source
    )  # fmt: skip


def hand_motion(
    imus: Sequence[ImuSamples], sensors: Sequence[SensorParameters], clocks: Sequence[Clock], unclipped: Sequence[Mask]
) -> HandMotion:
    """Return the readings in motion.

    Parameters
    ----------
    imus
        Raw.
    clocks
        Of each against the first, to some milliseconds.
    unclipped
        Of each IMU, which samples are within its range.

    Raises
    ------
    RecordingError
        If there is too little motion.
    """
    times = imus[0].seconds
    ready = [corrected_readings(imu, own) for imu, own in zip(imus, sensors, strict=True)]
    found = list(clocks)
    for k in range(1, len(imus)):
        within = _within((imus[0], imus[k]), (clocks[0], clocks[k]), (unclipped[0], unclipped[k]), times)
        found[k] = _clock(ready[k], clocks[k], ready[0], within)
    parts = [resampled(imu, clock, times) for imu, clock in zip(ready, found, strict=True)]
    known = np.logical_and.reduce([_within(imus, found, unclipped, times), *(part.known for part in parts)])
    base = parts[0].rates
    size = lengths(base)
    moving = known & (size > _MOVING * float(np.percentile(size, 99)))
    if int(moving.sum()) < _FEWEST:
        raise RecordingError(
            "hardly moves: turn and shake the array about all axes for half a minute", file=imus[0].source
        )
    axes = np.array([nearest_rotation(base[moving].T @ part.rates[moving]) for part in parts])
    rates = np.array([part.rates @ R.T for part, R in zip(parts, axes, strict=True)])
    mean = rates.mean(axis=0)
    cubics = local_cubics(times, usual_interval(times))
    slope, bend = cubics.slopes(mean), cubics.curvatures(mean)
    square = mean[:, :, None] * mean[:, None, :] - np.sum(mean**2, axis=1)[:, None, None] * np.eye(3)
    curvature = cubics.curvatures(square.reshape(-1, 9)).reshape(-1, 3, 3)
    used = np.flatnonzero(moving)
    used = used[np.unique(np.linspace(0, used.size - 1, min(used.size, _MOST)).astype(int))]
    forces = np.array([part.forces for part in parts])
    force_slopes = np.array([cubics.slopes(part.forces) for part in parts])
    deviation = _slope_deviation(mean, slope, times)
    return HandMotion(
        times[used], rates[:, used], forces[:, used], force_slopes[:, used], axes, slope[used], bend[used],
        curvature[used], deviation[used], tuple(found), sudden_change(times[known], rates[:, known], slope[known]),
    )  # fmt: skip


def _slope_deviation(mean: Array, slope: Array, times: Array) -> Array:
    """Return the deviation of derivatives of a mean rate, (n,), rad/s^2."""
    central = np.gradient(mean, times, axis=0)
    by_noise = 0.51 * float(np.sqrt(np.mean(white_noise(mean) ** 2))) / usual_interval(times)
    return np.asarray(np.sqrt(np.mean((central - slope) ** 2, axis=1) + by_noise**2) + 1e-9)


def _within(
    imus: Sequence[ImuSamples], clocks: Sequence[Clock], unclipped: Sequence[Mask], times: Array
) -> Mask:  # fmt: skip
    """Return at which times no IMU is clipped, nor the samples beside it."""
    out = np.ones(times.size, dtype=bool)
    for imu, clock, good in zip(imus, clocks, unclipped, strict=True):
        near = np.clip(np.searchsorted(imu.seconds, clock.reference_time(times)), 2, imu.seconds.size - 2)
        for step in (-2, -1, 0, 1):
            out &= good[near + step]
    return out


def _clock(imu: ImuSamples, clock: Clock, base: ImuSamples, within: Mask) -> Clock:
    """Return the clock of an IMU against the first one, from corrected readings of both; `clock` to milliseconds.

    within: (n,), samples of the base at which both are within their ranges.
    """
    seen = resampled(imu, clock, base.seconds)
    used = seen.known & within
    turn = nearest_rotation(base.rates[used].T @ seen.rates[used])
    return refined_clock(replace(imu, rates=imu.rates @ turn.T), clock, base, within).clock


def matrix_deviation(calibrations: Sequence[Calibration | None], usual: float, common: float) -> Array:
    """Return the deviation (9,) of the entries of the mean gyro matrix, by those of the IMUs' calibrations.

    usual, common: of an entry where there is none, and of what all IMUs err by in common.
    """
    own = [
        usual * np.ones(9) if one is None else np.maximum(one.sensor_sd.K_omega.ravel(), 1e-6) for one in calibrations
    ]
    return np.asarray(np.hypot(np.sqrt(np.sum(np.square(own), axis=0)) / len(own), common))

"""Readings of an IMU at the times of another one, by cubics through four neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel._kernels.quadrature import interpolate
from kreisel.array.lower_rate import smoothed, window_for
from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.slopes import LONGEST_GAP, usual_interval
from kreisel.recording.recording import ImuSamples
from kreisel.synchronization.clock import Clock

_CLIPPED = 3
"""Equal readings at an end of the range, and next to each other, from which on they count as clipped. Chosen: noise
rarely gives the largest reading thrice; a device at its limit always does."""


@dataclass(frozen=True)
class Resampled:
    """Readings at given times.

    Attributes
    ----------
    rates, forces : (n, 3)
        Raw.
    temperature : (n,) or None
    known : (n,)
        Whether there are readings around; the others are zero.
    """

    rates: Array
    forces: Array
    temperature: Array | None
    known: Mask


def resampled(imu: ImuSamples, clock: Clock, times: Array, *, smooth: bool = False) -> Resampled:
    """Return the readings of an IMU at times of another one.

    Parameters
    ----------
    clock
        t = start + (1 + skew) tau, with tau the seconds of `imu`.
    times : (n,)
        t, ascending.
    smooth
        Whether readings of a higher rate are smoothed first, so that all of them count.
    """
    own = imu.seconds
    tau = clock.reference_time(times)
    longest, ends = max(LONGEST_GAP, 5.0 * usual_interval(own)), (own[0], own[-1])
    clipped = clipped_samples(imu.rates) | clipped_samples(imu.accelerations)
    window = window_for(imu, usual_interval(times)) if smooth else 1
    if window > 1:
        imu, _ = smoothed(imu, window)
        clipped = np.convolve(clipped, np.ones(window), "same") > 0.5
        own = imu.seconds
    joined, after = _joined(imu), np.empty(times.size, dtype=np.int64)
    values = np.empty((times.size, joined.shape[1]))
    interpolate(own, joined, tau, after, values)
    known = (tau >= ends[0]) & (tau <= ends[1]) & (own[after] - own[after - 1] <= longest)
    if clipped.any():
        first = np.clip(after - 2, 0, own.size - 4)
        known &= ~(clipped[first] | clipped[first + 1] | clipped[first + 2] | clipped[first + 3])
    values[~known] = 0.0
    temperature = values[:, 6] if imu.temperature is not None else None
    return Resampled(values[:, :3], values[:, 3:6], temperature, known)


def _joined(imu: ImuSamples) -> Array:
    parts = [imu.rates, imu.accelerations]
    return np.hstack(parts if imu.temperature is None else [*parts, imu.temperature[:, None]])


def clipped_samples(values: Array) -> Mask:
    """Return which samples of a triad (n, 3) lie at the end of its range, (n,)."""
    out = np.zeros(len(values), dtype=bool)
    for column in np.abs(values).T:
        at_end = (column >= column.max() * (1.0 - 1e-12)) & (np.ptp(column) > 0.0)  # a dead one has no range
        runs = at_end[2:] & at_end[1:-1] & at_end[:-2]
        if int(at_end.sum()) >= _CLIPPED and runs.any():
            out |= at_end
    return out


def white_noise(values: Array) -> Array:
    """Return standard deviations (3,) of white noise by third differences, whose median motion hardly touches.

    Of readings in steps, most of whose differences are zero, their rms.
    """
    difference = np.abs(np.diff(values, 3, axis=0))
    # of third differences the variance is 20 times that of the noise; 0.6745 makes a median absolute value a deviation
    usual = np.median(difference, axis=0) / 0.6745
    return np.asarray(np.where(usual > 0.0, usual, np.sqrt(np.mean(difference**2, axis=0))) / 20.0**0.5 + 1e-12)

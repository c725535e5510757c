"""Readings of an IMU at the times of another one, by cubics through four neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    last = np.clip(np.searchsorted(own, tau, side="right"), 1, own.size - 1)
    first = np.clip(last - 2, 0, own.size - 4)
    known = (tau >= own[0]) & (tau <= own[-1])
    known &= (own[last] - own[last - 1]) <= max(LONGEST_GAP, 5.0 * usual_interval(own))
    clipped = clipped_samples(imu.rates) | clipped_samples(imu.accelerations)
    window = window_for(imu, usual_interval(times)) if smooth else 1
    if window > 1:
        imu, _ = smoothed(imu, window)
        clipped = np.convolve(clipped, np.ones(window), "same") > 0.5
        own = imu.seconds
    if clipped.any():
        known &= ~(clipped[first] | clipped[first + 1] | clipped[first + 2] | clipped[first + 3])
    weights, joined = _lagrange([own[first + k] - tau for k in range(4)]), _joined(imu)
    values = np.zeros((times.size, joined.shape[1]))
    for k in range(4):
        values += np.where(known, weights[k], 0.0)[:, None] * joined[first + k]
    temperature = values[:, 6] if imu.temperature is not None else None
    return Resampled(values[:, :3], values[:, 3:6], temperature, known)


def _joined(imu: ImuSamples) -> Array:
    parts = [imu.rates, imu.accelerations]
    return np.hstack(parts if imu.temperature is None else [*parts, imu.temperature[:, None]])


def _lagrange(x: Sequence[Array]) -> list[Array]:
    """Return weights (n,) of values at four x (n,) in that at zero of the cubic through them."""
    out = []
    for k, own in enumerate(x):
        others = [x[j] for j in range(4) if j != k]
        above, below = others[0] * others[1] * others[2], np.ones_like(own)
        for other in others:
            below *= other - own
        out.append(above / below)
    return out


def clipped_samples(values: Array) -> Mask:
    """Return which samples of a triad (n, 3) lie at the end of its range, (n,)."""
    out = np.zeros(len(values), dtype=bool)
    for column in np.abs(values).T:
        at_end = column >= column.max() * (1.0 - 1e-12)
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

"""What vibration between the samples does to the mean rate and force, and sampled readings do not show.

A body that cones or sculls turns, or moves, on average, by second-order terms of its vibration. The integrals over
sampling intervals are those of polynomials through six samples: of two to five samples in a period too little of these
terms is left.
"""

from __future__ import annotations

import math

import numpy as np

from kreisel.geometry.rotation import Array, log
from kreisel.inertial.strapdown import integrate_attitude, linear_rate, prepare

_FINER = 4
"""Samples by which one is replaced. Chosen: of the highest frequency that readings hold, eight to a period."""

SLOW = 0.1
"""Share of the sampling rate below which the polynomials are exact: at it, they lack 0.02 % of an integral."""

_ENOUGH = 40_000
"""Samples that show how large second differences are."""

_CHUNK = 1 << 14
"""Samples that are looked at at once."""

_EDGE = 64
"""Samples at either end of these that are left out: there the others do not continue."""


def most_missed(interval: float, rates: Array, accelerations: Array) -> tuple[float, float]:
    """Return upper bounds of what `missed_by_sampling` can find, rad/s and m/s^2, by second differences alone.

    Both are products of three axes, and of angles no larger than the slowest vibration has.
    """
    step = max(1, len(rates) // _ENOUGH)
    rate, force = (
        float(np.mean((x[:-2:step] - 2.0 * x[1:-1:step] + x[2::step]) ** 2)) ** 0.5
        / (2.0 * math.sin(math.pi * SLOW)) ** 2
        for x in (rates, accelerations)
    )
    slowest = 2.0 * math.pi * SLOW / interval
    return 3.0 * rate**2 / slowest, 3.0 * rate * force / slowest


def missed_by_sampling(interval: float, rates: Array, accelerations: Array) -> tuple[Array, Array]:
    """Return the mean rate and force (3,) that integrals of readings miss of a vibration.

    Parameters
    ----------
    interval
        Between samples, s.
    rates, accelerations : (n, 3)
        Readings, rad/s and m/s^2, as of a moment each.
    """
    count = max(1, len(rates) // _CHUNK)
    found, samples = np.zeros(6), 0
    for part in np.array_split(np.hstack([rates, accelerations]), count):
        if len(part) > 4 * _EDGE:
            found += (len(part) - 2 * _EDGE) * _missed(interval, part)
            samples += len(part) - 2 * _EDGE
    found /= max(samples, 1)
    return found[:3], found[3:]


def _missed(interval: float, readings: Array) -> Array:
    """Return what is missed of the mean rate and force (6,): the vibration's in finer steps, less that in their own."""
    n = len(readings)
    spectrum = np.fft.rfft(readings - readings.mean(axis=0), axis=0)
    spectrum[: int(SLOW * n)] = 0.0
    finer = np.zeros((_FINER * n // 2 + 1, 6), dtype=complex)
    finer[: len(spectrum)] = spectrum
    coarse = np.fft.irfft(spectrum, n, axis=0)[_EDGE:-_EDGE]
    fine = _FINER * np.fft.irfft(finer, _FINER * n, axis=0)[_FINER * _EDGE : -_FINER * _EDGE]
    return _means(interval / _FINER, fine) - _means(interval, coarse)


def _means(interval: float, readings: Array) -> Array:
    """Return the mean rate and force (6,) of a vibration, seen from where it began."""
    t = np.asarray(interval * np.arange(len(readings)), dtype=float)
    q = integrate_attitude(prepare(t, *np.split(readings, 2, axis=1)), linear_rate(np.eye(3), np.zeros(3)))
    turned, about = log(q), t - t.mean()
    trend = about @ turned / (about @ about)
    vibrating = turned - np.outer(about, trend) - turned.mean(axis=0)
    return np.concatenate([trend, np.mean(np.cross(vibrating, readings[:, 3:]), axis=0)])

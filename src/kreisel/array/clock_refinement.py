"""The clock of a calibrated IMU against that of another one on the same body, by least squares of their rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.resampled import resampled, white_noise
from kreisel.estimation.robust import normal_scale
from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.slopes import local_cubics, usual_interval
from kreisel.recording.recording import ImuSamples
from kreisel.synchronization.clock import Clock

_ROUNDS = 12
"""Times that the fit is repeated at most. Chosen: clocks begin within milliseconds, and noise of the slope makes a step
too small by a few tenths; what is left is below a nanosecond."""

_GROSS = 6.0
"""Standard deviations beyond which a sample is left out. Chosen: none of a million samples of noise is."""

_SHIFT, _GAIN = 12, 13
"""Columns of the clock; before them those of a matrix, by rows, and of offsets."""


@dataclass(frozen=True)
class RefinedClock:
    """How two calibrated IMUs on one body differ.

    Attributes
    ----------
    clock
        t = start + (1 + skew) tau, with tau the seconds of the unit and t those of the base.
    turned
        Difference of the rates that is proportional to them, as of a unit turned on its mount, over the rates; rms.
    explained
        Share of the change of the base's rates that the unit's explain.
    """

    clock: Clock
    turned: float
    explained: float


def refined_clock(unit: ImuSamples, clock: Clock, base: ImuSamples, within: Mask | None = None) -> RefinedClock:
    """Return a clock refined by least squares.

    Parameters
    ----------
    unit, base
        Corrected readings: angular rates of the common body.
    clock
        To some milliseconds.
    within : (n,)
        Samples of the base at which both are within their ranges; all by default.

    Notes
    -----
    Of a reading that is late by d the rate differs by d times its slope. A matrix near the identity and an offset are
    free, so that errors of the calibrations do not act on the clock.
    """
    times = base.seconds
    slope = local_cubics(times, usual_interval(times)).slopes(base.rates)
    middle, half = 0.5 * float(times[0] + times[-1]), 0.5 * float(times[-1] - times[0])
    along = (times - middle) / half
    noise = white_noise(base.rates) ** 2
    change, turned, explained = np.zeros(14), 0.0, 0.0
    for _ in range(_ROUNDS):
        seen = resampled(unit, clock, times)
        left = seen.rates - base.rates
        used = seen.known & np.isfinite(left).all(axis=1)
        if within is not None:
            used &= within
        if int(used.sum()) < 100:
            return RefinedClock(clock, 0.0, 0.0)
        change, deviation = _solved(base.rates, slope, along, left, used, noise)
        w = base.rates[used]
        M = change[:9].reshape(3, 3)
        turned = float(np.sqrt(np.mean((w @ M.T) ** 2) / max(float(np.mean(w**2)), 1e-300)))
        explained = 1.0 - float(np.var(left[used], axis=0).sum()) / max(float(np.var(w, axis=0).sum()), 1e-300)
        gain = float(change[_GAIN]) / half
        clock = Clock(
            clock.start + float(change[_SHIFT]) + gain * (clock.start - middle),
            (1.0 + clock.skew) * (1.0 + gain) - 1.0,
            float(np.hypot(*deviation)),  # at the beginning, half of the recording away from the middle
            float(deviation[1]) / half,
        )
        if abs(change[_SHIFT]) + abs(change[_GAIN]) < 1e-4 * base.interval:
            break
    return RefinedClock(clock, turned, explained)


def _solved(
    rates: Array, slope: Array, along: Array, left: Array, used: Mask, noise: Array
) -> tuple[Array, Array]:  # fmt: skip
    """Return the least squares solution (14,), and standard deviations (2,) of the clock's two parts."""
    weights, found, A, spread = used.astype(float), np.zeros(14), np.eye(14), 1.0
    for step in range(2):
        A, b = np.zeros((14, 14)), np.zeros(14)
        for j in range(3):
            places = [3 * j, 3 * j + 1, 3 * j + 2, 9 + j, _SHIFT, _GAIN]
            X = np.column_stack([rates, np.ones(len(rates)), slope[:, j], slope[:, j] * along])
            A[np.ix_(places, places)] += (X * weights[:, None]).T @ X
            b[places] += (X * weights[:, None]).T @ left[:, j]
            # what is left contains the base's noise with the other sign, and so does the column of its rate
            b[4 * j] += weights.sum() * noise[j]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        found = np.linalg.lstsq(A / size[:, None] / size, b / size, rcond=1e-12)[0] / size
        residual = left - rates @ found[:9].reshape(3, 3).T - found[9:12]
        residual -= slope * (found[_SHIFT] + found[_GAIN] * along)[:, None]
        length = np.sqrt(np.mean(residual**2, axis=1))
        spread = normal_scale(residual[used]) + 1e-15
        if not step:
            weights = weights * (length < _GROSS * spread)
    inverse = np.linalg.pinv(A / size[:, None] / size)[-2:, -2:] / size[-2:, None] / size[-2:]
    return found, spread * np.sqrt(np.maximum(np.diag(inverse), 0.0))

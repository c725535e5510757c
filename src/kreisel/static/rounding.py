"""Readings in steps: where noise does not carry them from one to the next, a standstill's mean errs by a part of one.

The error is the same whenever the device lies the same way: it does not average out, and nothing scatters by it. The
same holds for rates that a device sets to zero while they are small. Rates that it sets to zero whenever it notices a
standstill, however large they were, say nothing of the offsets with which it reads in motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf

import numpy as np

from kreisel.geometry.rotation import Array

_MANY = 4096
"""Different values at standstills, beyond which they lie so close that steps are no matter."""

_SAME = 1e-9
"""Difference of two values, over the largest, up to which they are one."""

_FINER, _OFTEN = 3.0, 0.05
"""How many times finer steps beyond it must be for a channel to be held at zero, and share of zeros at standstill."""

_NEAR = 0.5
"""Steps between the means of two standstills up to which they err alike."""

ZEROS = 0.01
"""Share of zeros at a standstill from which on its mean is about zero."""

_LEAST, _SCORINGS, _MOST = 0.2, 40, 0.3
"""Least noise, in steps, that shows where between two steps a mean is; times that it is improved, and by how many steps
at most."""

_NOISE = np.linspace(0.0, 1.0, 2001)
"""Variances of noise, over the square of a step, for which errors are tabulated."""

_ALL, _BLOCK, _QUIET, _NOISY = 0.9, 10, 20.0, 3.0
"""Share of samples at standstill that are zero on all axes if the device sets them so, samples whose noise in motion is
taken, percentile of these noises that is that of gentle motion, and steps that it must exceed. Chosen: with less noise
readings may be zero because they are rounded."""

_K = np.arange(1, 200)[:, None]
_ERROR = np.sum(np.exp(-4.0 * np.pi**2 * _K**2 * _NOISE) / (2.0 * np.pi**2 * _K**2), axis=0)
_SPREAD = _NOISE + _ERROR[0] - _ERROR
"""Variances of a mean's error, and within a standstill; see `rounding_variance`."""


def rounding_variance(values: Array, parts: Sequence[tuple[int, int]], means: Array) -> Array:
    """Return the variances of the means of standstills by steps of the readings, (M, 3).

    Averaged over standstills with the same mean, the variance is that of one.

    Parameters
    ----------
    values : (n, 3)
        All readings.
    parts
        First sample of each standstill, and the one after its last.
    means : (M, 3)

    Notes
    -----
    By equation (35) of docs/explanation/model.md. With the variance within a standstill, that of the error of its mean
    is the noise's and a twelfth of the step's square.
    """
    out = np.zeros_like(means)
    for axis in range(means.shape[1]):
        own = [values[a:b, axis] for a, b in parts]
        still = np.concatenate(own)
        held = _held(still, values[:, axis])
        step = 2.0 * held or _step(still, values[:, axis])
        if step == 0.0:
            continue
        spread = 0.0 if held else float(np.mean([part.var() for part in own]))
        out[:, axis] = _error(step, spread) * alike(means[:, axis], step)
    return out


def mean_of_truncated(values: Array, step: float) -> tuple[float, float]:
    """Return the mean of white noise about a constant, of readings that were truncated to zero, and its variance.

    The most likely one: about zero, two steps are one, so that the mean of the readings is not that of the noise.

    Parameters
    ----------
    values : (n,)
        As they were read.
    step
        Of the readings.

    Notes
    -----
    By scoring, of the probabilities that Gaussian noise has of each step. If it does not carry readings from one step
    to others, these do not show where between them the mean is.
    """
    steps, counts = np.unique(np.round(values / step), return_counts=True)
    low, high = np.where(steps > 0.0, steps, steps - 1.0), np.where(steps < 0.0, steps, steps + 1.0)
    plain = float(np.average(0.5 * (low + high), weights=counts))
    unknown = step * plain, (2.0 * step) ** 2 / 12.0
    x = np.array([plain, max(float(values.std()) / step, _LEAST)])
    information = np.zeros((2, 2))
    for _ in range(_SCORINGS):
        a, b = (low - x[0]) / x[1], (high - x[0]) / x[1]
        chance = np.maximum([0.5 * (erf(v) - erf(u)) for u, v in zip(a / 2**0.5, b / 2**0.5, strict=True)], 1e-12)
        at = [np.exp(-0.5 * u**2) / (2.0 * np.pi) ** 0.5 for u in (a, b)]
        slopes = np.stack([at[0] - at[1], a * at[0] - b * at[1]]) / x[1]
        information = counts.sum() * (slopes / chance) @ slopes.T
        if np.linalg.cond(information) > 1.0 / np.finfo(float).eps:
            return unknown
        move = np.linalg.solve(information, (slopes / chance) @ counts)
        x = x + move / max(1.0, float(np.abs(move).max()) / _MOST)
        if x[1] < _LEAST:
            return unknown
    variance = step**2 * float(np.linalg.inv(information)[0, 0])
    return (step * float(x[0]), variance) if variance < unknown[1] else unknown


def _error(step: float, spread: float) -> float:
    """Return the variance of a mean by steps; spread: that of the readings."""
    return step**2 * float(np.interp(spread / step**2, _SPREAD, _ERROR, right=0.0))


def alike(means: Array, step: float) -> Array:
    """Return how many of some means err as each does."""
    return np.asarray((np.abs(means[:, None] - means[None, :]) < _NEAR * step).sum(axis=1))


def steps_of(values: Array, parts: Sequence[tuple[int, int]]) -> Array:
    """Return the steps of readings (n, 3), (3,); zero for a channel whose values lie close.

    parts: first sample of each standstill, and the one after its last.
    """
    return np.array([_step(np.concatenate([own[a:b] for a, b in parts]), own) for own in values.T])


def motion_noise_if_silent(rates: Array, parts: Sequence[tuple[int, int]]) -> Array | None:
    """Return the noise of single readings in motion, (3,), if rates are set to zero at standstills; else None.

    Parameters
    ----------
    rates : (n, 3)
        All readings.
    parts
        First sample of each standstill, and the one after its last.
    """
    zero = (rates == 0.0).all(axis=1)
    if float(np.mean(np.concatenate([zero[a:b] for a, b in parts]))) < _ALL:
        return None
    moving = ~zero
    for a, b in parts:
        moving[a:b] = False
    third = np.abs(np.diff(rates[moving], 3, axis=0))
    blocks = len(third) // _BLOCK
    if not blocks:
        return None
    typical = np.median(third[: blocks * _BLOCK].reshape(blocks, _BLOCK, 3), axis=1)
    # of white noise, the third difference is Gaussian, too, with 20 times the variance
    noise = np.percentile(typical, _QUIET, axis=0) / (0.6745 * np.sqrt(20.0))
    steps = np.array([_step(own, own) for own in rates[moving].T])
    return np.asarray(noise) if (noise > _NOISY * steps).all() else None


def _held(still: Array, every: Array) -> float:
    """Return how large readings are at least that are not held at zero; 0 where none are held."""
    if float(np.mean(still == 0.0)) < _OFTEN:
        return 0.0
    least = _SAME * float(np.abs(every).max())
    sizes = np.unique(np.abs(every))
    beyond = sizes[sizes > least]
    steps = np.diff(beyond)
    fine = steps[steps > least]
    return float(beyond[0]) if fine.size and beyond[0] > _FINER * float(fine.min()) else 0.0


def _step(still: Array, every: Array) -> float:
    """Return the step of a channel at standstills; 0 where its values lie close."""
    found = np.unique(still)
    if found.size > _MANY:
        return 0.0
    # of a channel that never changes at standstill, the step is that to the next value while it moves
    steps = np.diff(found) if found.size > 1 else np.abs(every - found[0])
    steps = steps[steps > _SAME * float(np.abs(every).max())]
    return float(steps.min()) if steps.size else 0.0

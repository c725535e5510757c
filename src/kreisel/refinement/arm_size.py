"""How large the errors of an arm are whose joint angles nobody recorded: by the probability of the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kreisel.model.assumed_noise import AssumedNoise, PoseError

_RATIO = 2.0
"""Between sizes that are tried."""

_FEWEST, _MOST = -3, 6
"""Powers of it that are tried."""

_USUAL_SD = float(np.log(3.0))
"""Standard deviation of the logarithm of arms' sizes, before any look at the data."""

_QUIET = 0.05
"""Angle that gyros walk by noise while an arm keeps its posture, over its errors, up to which they show small ones.
Chosen: of 16 simulated runs with fog and ring-laser gyros it was 0.001 to 0.05, of 14 with MEMS gyros 0.02 to 12;
consumer-grade ones hid up to nine tenths of the arm."""


def most_likely_size(log_probability: Callable[[float], float]) -> float:
    """Return the most likely factor on the usual size of poses' errors.

    log_probability: of the data with errors of a size.
    """
    found: dict[int, float] = {}

    def at(power: int) -> float:
        if power not in found:
            size = float(_RATIO**power)
            found[power] = log_probability(size) - 0.5 * (np.log(size) / _USUAL_SD) ** 2
        return found[power]

    best = max((0, -1, 1), key=at)
    while _FEWEST < best < _MOST and (nearer := max((best - 1, best, best + 1), key=at)) != best:
        best = nearer
    if best in (_FEWEST, _MOST):
        return float(_RATIO**best)
    # the vertex of the parabola through three
    before, here, after = at(best - 1), at(best), at(best + 1)
    bend = before - 2.0 * here + after
    vertex = 0.0 if bend >= 0.0 else 0.5 * (before - after) / bend
    return float(_RATIO ** (best + np.clip(vertex, -0.5, 0.5)))


def with_arm_size(noise: AssumedNoise, size: float, gyro_noise: float) -> AssumedNoise:
    """Return the noise with errors of an arm whose poses show a factor on the usual size.

    Errors of the frames are as large. Errors smaller than usual are taken from quiet gyros alone, and in small turns
    only if they are smaller than small turns explain.

    Parameters
    ----------
    gyro_noise
        Largest noise density of the gyros, rad/s/Hz^0.5.
    """
    own, sd = noise.pose_error, noise.frame_sd
    if size < 1.0 and gyro_noise * own.time**0.5 > _QUIET * size * own.orientation:
        return noise
    frames = _frames(own, size)
    return replace(noise, frame_sd=(frames * sd[0], frames * sd[1]), pose_error=own.larger(size))


def with_larger_frames(noise: AssumedNoise, usual: AssumedNoise, size: float) -> AssumedNoise:
    """Return the noise with errors of an arm's frames of a factor on the usual size, where that is larger.

    An effect that is not estimated yet makes all noise larger, and hides an arm before cheap gyros: of 14 simulated
    runs of consumer grade the size that is shown at first was half of that at the end, and scattered by 0.8 instead of
    0.5 of itself.
    """
    frames = _frames(usual.pose_error, size)
    length, angle = noise.frame_sd
    return replace(noise, frame_sd=(max(length, frames * usual.frame_sd[0]), max(angle, frames * usual.frame_sd[1])))


def _frames(usual: PoseError, size: float) -> float:
    """Return the factor on the usual errors of frames."""
    return min(size / usual.reached, max(size, 1.0))

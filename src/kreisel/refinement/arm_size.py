"""How large the errors of an arm are whose joint angles nobody recorded: by the probability of the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kreisel.model.assumed_noise import AssumedNoise

_RATIO = 2.0
"""Between sizes that are tried."""

_FEWEST, _MOST = -2, 6
"""Powers of it that are tried. Smaller errors than usual ones are not assumed: noise of cheap gyros hides them."""

_USUAL_SD = float(np.log(3.0))
"""Standard deviation of the logarithm of arms' sizes, before any look at the data."""

_FRAMES = 1.7
"""Size of an arm's errors over that which its poses show as a process of some seconds. Chosen: of 50 simulated runs of
three arms it was 1.0 to 2.0; a pose changes more smoothly than such a process."""


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


def with_arm_size(noise: AssumedNoise, size: float) -> AssumedNoise:
    """Return the noise with errors of an arm whose poses show a factor on the usual size, never less than usual."""
    frames, poses = max(1.0, _FRAMES * size), max(1.0, size)
    sd = noise.frame_sd
    return replace(noise, frame_sd=(frames * sd[0], frames * sd[1]), pose_error=noise.pose_error.larger(poses))

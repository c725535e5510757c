"""How many samples are lost without a gap in the stamps: the rate then changes twice as much from one to the next."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import lengths
from kreisel.recording.recording import ImuSamples
from kreisel.static.rests import Rests

_CLEAR = 8.0
"""Change of the rate from sample to sample over its noise from which on a step shows whether one is missing."""

_EVEN = 0.4
"""Share by which each of the four steps beside one may differ from their mean: a hand that turns a device with a jerk
makes the step in the middle larger than those around it, with nothing missing. Chosen: noise is half of it at most."""

_CERTAIN = 1.5
"""Deviations between the count and the least and largest that it stands for."""

_LARGER = 4.0
"""Square of what the noise of turns may exceed what is found. Chosen: a dozen turns show it within a factor of two."""

_GAP = 1.6
"""Intervals from one stamp to the next from which on a sample is missing there, which the stamps show."""

_TWICE, _NONE = (1.6, 2.5), (-0.5, 0.4)
"""Step over that of the neighbours where a sample is missing, and as far on the other side of one, where no reason
leads: what jerks in every way does both alike."""


def lost_share(imu: ImuSamples, rests: Rests, turn_noise: float = np.inf) -> tuple[float, float]:
    """Return the least and the largest share of samples that are lost; zeros where the readings cannot tell.

    Turns are then too small by as much: the gyros' scale factors err by it, and nothing else shows that.

    Parameters
    ----------
    turn_noise
        Error of turns over the root of the integral of their squared rate, sqrt(s). A share s that is lost at random
        makes it at least the root of s times the interval, which limits a share that no step shows.
    """
    w = imu.rates
    steps = np.diff(w, axis=0)
    step, beside = steps[2:-2], np.stack([steps[:-4], steps[1:-3], steps[3:-1], steps[4:]])
    usual = beside.mean(axis=0)
    size = lengths(usual)
    clear = size > _CLEAR * np.sqrt(np.sum(rests.density_w**2) / imu.interval)
    clear &= np.linalg.norm(beside - usual, axis=2).max(axis=0) < _EVEN * size
    gap = np.diff(imu.stamps_ns) > _GAP * 1e9 * imu.interval
    clear &= ~np.any([gap[k : gap.size - 4 + k] for k in range(5)], axis=0)
    if not clear.any():
        return 0.0, 0.0
    ratio = np.einsum("ij,ij->i", step, usual)[clear] / size[clear] ** 2
    twice, none = (int(np.count_nonzero((ratio > low) & (ratio < high))) for low, high in (_TWICE, _NONE))
    if twice <= none:
        return 0.0, 0.0
    chance = _CERTAIN * np.sqrt(twice + none)
    count = float(clear.sum())
    least, most = max(twice - none - chance, 0.0) / count, (twice - none + chance) / count
    return least, most if least else min(most, _LARGER * turn_noise**2 / imu.interval)

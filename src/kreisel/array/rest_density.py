"""Noise densities of several IMUs on one body, from their readings at its standstills, all by the same samples.

Standstills are found without a threshold for motion: at rest the differences of averages follow from the scatter of the
samples within them; in motion they are many times as large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask

AVERAGED = 0.1
"""s of an average. Chosen: interpolated samples, low-pass filters and the noise of angular accelerations at lever arms
change a density little at such a length, and standstills of a second hold ten."""

_PARTS = 10
"""Averages of a window that is at rest or not."""

_EXCESS = 4.0
"""Largest ratio of the differences of averages to what the scatter within them says, at rest. Chosen: that of white
noise through a low-pass of a tenth of the sample rate is 3, that of a steady slope is 120."""

_ENERGY = 2.5
"""Largest ratio of a window's differences to the lower quartile of those of windows at rest. Chosen: a thousandth of
windows of white noise have larger ones; three quarters may be slow motion."""

MIN_PAIRS = 50
"""Pairs of averages below which no density is given; its deviation is then a twentieth, with three axes."""


@dataclass(frozen=True)
class Standstills:
    """Averages of samples, and which neighbours of them are at rest.

    Attributes
    ----------
    width
        Samples of an average.
    seconds
        Length of an average.
    pairs : (k,)
        Averages that are at rest together with the next one.
    """

    width: int
    seconds: float
    pairs: Indices

    def density(self, values: Array, known: Mask) -> float | None:
        """Return the noise density of readings (n, 3), rms over the axes; None where too few pairs are known.

        known : (n,)
            Whether readings are there.

        Notes
        -----
        The Allan deviation at `seconds`, times the root of `seconds`.
        """
        whole = _whole(known, self.width)
        pairs = self.pairs[whole[self.pairs] & whole[self.pairs + 1]]
        if pairs.size < MIN_PAIRS:
            return None
        mean = _parts(values, self.width).mean(axis=1)
        return float(np.sqrt(0.5 * self.seconds * np.mean((mean[pairs + 1] - mean[pairs]) ** 2)))


def standstills(times: Array, readings: Sequence[Array], known: Mask) -> Standstills:
    """Return the standstills that readings at times (n,) show.

    readings
        Of several sensors, (n, 3) each; all of them must be at rest.
    """
    step = float(np.median(np.diff(times)))
    width = max(4, round(AVERAGED / step))
    t = _parts(times, width)
    regular = _whole(known, width) & (t[:, -1] - t[:, 0] < 1.5 * width * step)
    starts = np.arange(0, max(regular.size - _PARTS + 1, 0), _PARTS // 2)
    places = starts[:, None] + np.arange(_PARTS - 1)
    still = (regular[1:] & regular[:-1])[places].all(axis=1)
    energies = []
    for values in readings:
        parts = _parts(values, width)
        within = parts.var(axis=1, ddof=1).sum(axis=1) / width
        between = 0.5 * np.sum(np.diff(parts.mean(axis=1), axis=0) ** 2, axis=1)
        energies.append(between[places].mean(axis=1))
        still &= energies[-1] <= _EXCESS * within[places].mean(axis=1)
    limits = [_ENERGY * float(np.percentile(energy[still], 25.0)) if still.any() else 0.0 for energy in energies]
    for energy, limit in zip(energies, limits, strict=True):
        still &= energy <= limit
    return Standstills(width, width * step, np.unique(places[still]))


def _parts(values: Array, width: int) -> Array:
    """Return values (n, …) in parts, (n // width, width, …)."""
    n = len(values) // width
    return values[: n * width].reshape(n, width, *values.shape[1:])


def _whole(known: Mask, width: int) -> Mask:
    """Return which parts are known, (n // width,)."""
    n = known.size // width
    return np.asarray(known[: n * width].reshape(n, width).all(axis=1))

"""Standstills, and what the IMU reads there."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask


@dataclass(frozen=True)
class Rests:
    """Standstills, (M,) of each.

    Attributes
    ----------
    first, last
        First sample, and the one after the last.
    seconds
        Middle, IMU seconds.
    durations
        s.
    rates, forces : (M, 3)
        Mean readings.
    creep : (M,)
        Rms change of the force within a standstill that is not noise, m/s^2.
    turning : (M, 3)
        Rate at which gravity turns within a standstill, in the device's axes, rad/s; about the vertical it shows none.
    density_w, density_a : (3,)
        White noise of gyros and accelerometers at standstill, per root hertz.
    rounding_w, rounding_a : (M, 3)
        Variances of the means by readings in steps, that are the same at standstills with the same mean.
    clipped
        Number of standstills that are none of these, because a reading was at the end of its range.
    silent
        Whether the device sets rates to zero at standstills, so that these say nothing.
    """

    first: Indices
    last: Indices
    seconds: Array
    durations: Array
    rates: Array
    forces: Array
    creep: Array
    turning: Array
    density_w: Array
    density_a: Array
    rounding_w: Array
    rounding_a: Array
    clipped: int = 0
    silent: bool = False

    @property
    def count(self) -> int:
        """Number of standstills."""
        return int(self.first.size)

    def means_of(self, features: Array) -> Array:
        """Return the mean of features (F, n) over every standstill, (M, F)."""
        before = np.concatenate([np.zeros((len(features), 1)), np.cumsum(features, axis=1)], axis=1)
        return np.asarray((before[:, self.last] - before[:, self.first]).T / (self.last - self.first)[:, None])

    def part(self, keep: Mask | Indices) -> Rests:
        """Return some of the standstills."""
        common = ("density_w", "density_a", "clipped", "silent")
        kept = {one.name: getattr(self, one.name)[keep] for one in fields(self) if one.name not in common}
        return replace(self, **kept)

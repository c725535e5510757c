"""Derivatives of sampled readings: of the cubic closest to the seven samples around each.

The cubic averages the noise that a difference of two samples multiplies: the slope of white noise of deviation s,
sampled every h seconds, has a deviation of 0.51 s / h. It is exact for motions that are cubics in time; of one of
frequency f it misses a share of 0.208 (2 pi f h)^4. It needs three samples on either side, so that a stream is late by
three samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices

SAMPLES = 7
"""Samples that a cubic is fitted to."""

REACH = SAMPLES // 2
"""Samples before and after the one whose derivatives are wanted."""

DEGREE = 3
"""Of the polynomial: a cubic has the first and the second derivative; noise and error of it are stated above."""

LONGEST_GAP = 0.05
"""Seconds between two samples, and at least five usual intervals, beyond which no cubic reaches across."""

USUAL = 100
"""Intervals at the beginning whose median is the usual one."""


def usual_interval(stamps: Array) -> float:
    """Return the usual interval of stamps (n,): the median of the first `USUAL`; 0 for fewer than two samples."""
    return float(np.median(np.diff(stamps[: USUAL + 1]))) if stamps.size > 1 else 0.0


def run_starts(stamps: Array, usual: float) -> Indices:
    """Return the first sample of each run but the first; see `local_cubics`."""
    return np.flatnonzero(np.diff(stamps) > max(LONGEST_GAP, 5.0 * usual)) + 1


@dataclass(frozen=True)
class LocalCubics:
    """Weights that give derivatives of samples.

    Attributes
    ----------
    samples : (n, 7)
        Which samples each cubic is fitted to.
    slope, curvature : (n, 7)
        Weights of their values in the first and second derivative.
    """

    samples: Indices
    slope: Array
    curvature: Array

    def slopes(self, values: Array) -> Array:
        """Return first derivatives (n, k) of values (n, k)."""
        return _weighted(self.slope, values, self.samples)

    def curvatures(self, values: Array) -> Array:
        """Return second derivatives (n, k) of values (n, k)."""
        return _weighted(self.curvature, values, self.samples)


def local_cubics(stamps: Array, usual: float) -> LocalCubics:
    """Return the cubics around each sample.

    Parameters
    ----------
    stamps : (n,)
        Seconds, ascending. After a gap the samples form a new run; a run of fewer than seven has a polynomial of lower
        degree, and a single sample has no slope.
    usual
        Usual interval, s; see `LONGEST_GAP`.

    Notes
    -----
    Polynomials that are orthogonal on the samples, by their three-term recurrence: p_(k+1) = (u - a_k) p_k - b_k
    p_(k-1).
    """
    n = stamps.size
    edges = np.concatenate([[0], run_starts(stamps, usual), [n]])
    of_run = np.searchsorted(edges, np.arange(n), side="right") - 1
    start, stop = edges[of_run], edges[of_run + 1]
    first = np.clip(np.arange(n) - REACH, start, np.maximum(stop - SAMPLES, start))
    samples = first[:, None] + np.arange(SAMPLES)
    used = samples < stop[:, None]
    samples = np.minimum(samples, stop[:, None] - 1)
    span = np.maximum(stamps[samples[:, -1]] - stamps[samples[:, 0]], 1e-9)
    u = (stamps[samples] - stamps[:, None]) / span[:, None]
    slope, curvature = _weights(u, used)
    return LocalCubics(samples, slope / span[:, None], curvature / span[:, None] ** 2)


def _weights(u: Array, used: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return weights (n, 7) of values at times u (n, 7) in both derivatives at u = 0 of the closest cubic."""
    slope, curvature = np.zeros_like(u), np.zeros_like(u)
    count = used.sum(axis=1)
    before, p, size_before = np.zeros_like(u), used.astype(float), np.ones(len(u))
    # of the polynomial: its value at u = 0 and that of both derivatives
    at_before, at = np.zeros((len(u), 3)), np.tile([1.0, 0.0, 0.0], (len(u), 1))
    for degree in range(DEGREE + 1):
        size = np.where(count > degree, np.einsum("ij,ij->i", p, p), 1.0)
        share = at[:, 1:] * ((count > degree) / size)[:, None]
        slope += p * share[:, :1]
        curvature += p * share[:, 1:]
        a = (np.einsum("ij,ij,ij->i", u, p, p) / size)[:, None]
        b = (size / size_before)[:, None] if degree else np.zeros((len(u), 1))
        before, p = p, (u - a) * p - b * before
        rising = np.column_stack([np.zeros(len(u)), at[:, 0], 2.0 * at[:, 1]])
        at_before, at = at, rising - a * at - b * at_before
        size_before = size
    return slope, curvature


def _weighted(weights: Array, values: Array, samples: Indices) -> Array:
    return np.asarray(np.einsum("ij,ijk->ik", weights, np.asarray(values, dtype=float)[samples]))

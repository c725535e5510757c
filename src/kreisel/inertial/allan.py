"""The Allan deviation of readings at rest, and the noise figures in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kreisel.geometry.rotation import Array, Indices

FLOOR = 0.664
"""Floor of the Allan deviation over the bias instability B: sqrt(2 ln 2 / pi)."""

_PER_DECADE, _MISFIT = 10, 0.1
"""Cluster sizes in a decade, and relative uncertainty of a point besides that of its average. Chosen: more sizes are
averages of nearly the same readings; no sensor has just the noises of the model."""


@dataclass(frozen=True)
class NoiseFigures:
    """Figures of IEEE 952 for each axis, (3,), in the readings' unit.

    Attributes
    ----------
    density
        N, white noise, per root hertz.
    instability
        B, flicker noise.
    walk
        K, random walk of the offset, per second and root hertz.
    """

    density: Array
    instability: Array
    walk: Array


def allan_deviation(values: Array, clusters: Indices) -> Array:
    """Return the overlapping Allan deviation (m, 3) of readings (n, 3).

    Parameters
    ----------
    clusters : (m,)
        Numbers of readings averaged together, each less than half of all.

    Notes
    -----
    IEEE 952-1997, annex C: of second differences of the integral.
    """
    integral = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)])
    out = np.empty((clusters.size, values.shape[1]))
    for i, m in enumerate(clusters.tolist()):
        second = integral[2 * m :] - 2.0 * integral[m:-m] + integral[: -2 * m]
        out[i] = np.sqrt(0.5 * np.einsum("ij,ij->j", second, second) / len(second)) / m
    return out


def usual_clusters(count: int) -> Indices:
    """Return numbers of readings (m,) to average together: ten a decade, up to a tenth of all."""
    decades = np.log10(max(count / 10.0, 2.0))
    return np.unique(np.round(np.logspace(0.0, decades, max(int(_PER_DECADE * decades), 2))).astype(np.int64))


def noise_figures(values: Array, interval: float) -> NoiseFigures:
    """Return the noise figures of readings (n, 3) at rest.

    Notes
    -----
    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (0.664 B)^2 + K^2 tau / 3, by least squares in which each point counts by
    its own relative uncertainty, sqrt(tau / T), and 10 % because no sensor has just these noises; no figure is
    negative. Q, the quantisation, is not returned.
    """
    clusters = usual_clusters(len(values))
    tau: Array = clusters.astype(float) * interval
    variance = allan_deviation(values, clusters) ** 2
    weight: Array = np.asarray(1.0 / np.sqrt(clusters / len(values) + _MISFIT**2), dtype=float)
    figures = [_fitted(tau, one, weight) for one in variance.T]
    squares = np.array(figures).T
    return NoiseFigures(np.sqrt(squares[1]), np.sqrt(squares[2]), np.sqrt(squares[3]))


def _fitted(tau: Array, variance: Array, weight: Array) -> Array:
    """Return Q^2, N^2, B^2 and K^2, none of them negative: the best of all subsets without a negative one."""
    terms = np.column_stack([3.0 / tau**2, 1.0 / tau, np.full(tau.size, FLOOR**2), tau / 3.0])
    size = np.maximum(variance, 1e-300)
    A, b = terms * (weight / size)[:, None], weight
    best, least = np.zeros(4), np.inf
    for count in range(1, 5):
        for subset in combinations(range(4), count):
            own = list(subset)
            scale = np.linalg.norm(A[:, own], axis=0)
            x = np.linalg.lstsq(A[:, own] / scale, b, rcond=None)[0] / scale
            misfit = float(np.sum((A[:, own] @ x - b) ** 2))
            if np.all(x >= 0.0) and misfit < least:
                best, least = np.zeros(4), misfit
                best[own] = x
    return best

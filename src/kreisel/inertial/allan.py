"""The Allan deviation of readings at rest, and the noise figures in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices

FLOOR = 0.664
"""Floor of the Allan deviation over the bias instability B: sqrt(2 ln 2 / pi)."""

_PER_DECADE, _MISFIT = 10, 0.1
"""Cluster sizes in a decade, and relative uncertainty of a point besides that of its average. Chosen: more sizes are
averages of nearly the same readings; no sensor has just the noises of the model."""


TERMS = ("quantisation", "density", "instability", "walk", "ramp")
"""Names of the noises of IEEE 952, in the order of the powers of the averaging time."""

_ALIKE = 3.0
"""Points of the curve that are as good as one, for their averages share readings. Chosen: of drawn noise, B scatters by
0.9 of its deviation then, N by 0.3."""

_SHOWN, _CERTAIN = 0.3, 2.0
"""Share of the variance that a noise has at some averaging time, and deviations it lies from zero, if it is shown."""


@dataclass(frozen=True)
class NoiseFigures:
    """Figures of IEEE 952 for each axis, (3,), in the readings' unit.

    Attributes
    ----------
    quantisation
        Q, of the integral.
    density
        N, white noise, per root hertz.
    instability
        B, flicker noise.
    walk
        K, random walk of the offset, per second and root hertz.
    ramp
        R, a steady change of the offset, per second.
    deviation
        Standard deviation of each, by name.
    shown
        Whether the curve shows each, by name: elsewhere it may be anything that is smaller than the others at all
        averaging times.
    tau, curve, fitted : (m,), (m, 3), (m, 3)
        Averaging times, s; the Allan deviation, and what the figures make of it.
    """

    quantisation: Array
    density: Array
    instability: Array
    walk: Array
    ramp: Array
    deviation: dict[str, Array]
    shown: dict[str, NDArray[np.bool_]]
    tau: Array
    curve: Array
    fitted: Array


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
    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (0.664 B)^2 + K^2 tau / 3 + R^2 tau^2 / 2, by least squares in which each
    point counts by its own relative uncertainty, sqrt(tau / T), and 10 % because no sensor has just these noises; no
    figure is negative.
    """
    clusters = usual_clusters(len(values))
    tau: Array = clusters.astype(float) * interval
    curve = allan_deviation(values, clusters)
    weight: Array = np.asarray(1.0 / np.sqrt(clusters / len(values) + _MISFIT**2), dtype=float)
    terms = np.column_stack(
        [3.0 / tau**2, 1.0 / tau, np.full(tau.size, FLOOR**2), tau / 3.0, 0.5 * tau**2]
    )  # by the squares of the figures
    fits = [_fitted(terms, one, weight) for one in (curve**2).T]
    squares, variances = (np.array([fit[i] for fit in fits]).T for i in (0, 1))
    figures = np.sqrt(squares)
    deviation = np.sqrt(variances) / np.maximum(2.0 * figures, 1e-300)
    parts = terms.T[:, :, None] * squares[:, None]
    fitted = parts.sum(axis=0)
    share = (parts / np.maximum(fitted, 1e-300)).max(axis=1)
    shown = (share > _SHOWN) & (figures > _CERTAIN * deviation)
    Q, N, B, K, R = figures
    by_name = [dict(zip(TERMS, part, strict=True)) for part in (deviation, shown)]
    return NoiseFigures(Q, N, B, K, R, by_name[0], by_name[1], tau, curve, np.sqrt(fitted))


def _fitted(terms: Array, variance: Array, weight: Array) -> tuple[Array, Array]:
    """Return the squares of the figures, none negative, and their variances: the best of all subsets of terms."""
    A, b = terms * (weight / np.maximum(variance, 1e-300))[:, None], weight
    count = terms.shape[1]
    best, spread, least = np.zeros(count), np.zeros(count), np.inf
    for size in range(1, count + 1):
        for subset in combinations(range(count), size):
            own = list(subset)
            scale = np.linalg.norm(A[:, own], axis=0)
            scaled = A[:, own] / scale
            x = np.linalg.lstsq(scaled, b, rcond=None)[0] / scale
            misfit = float(np.sum((A[:, own] @ x - b) ** 2))
            if np.all(x >= 0.0) and misfit < least:
                best, spread, least = np.zeros(count), np.zeros(count), misfit
                best[own] = x
                larger = max(1.0, misfit / max(b.size - size, 1))  # the curve is not just that of these noises
                spread[own] = larger * _ALIKE * np.diag(np.linalg.pinv(scaled.T @ scaled)) / scale**2
    return best, spread


WARM_UP, _PARTS = 10.0, 20
"""Change of the mean from the first fifth of a recording to the last, over the usual one between neighbouring
twentieths of its second half, from which on it counts as warming up. Chosen: a random walk does so in 0.5 %."""


def warms_up(values: Array) -> NDArray[np.bool_]:
    """Return which axes (3,) of readings at rest change more from beginning to end than they wander at last."""
    means = np.array([part.mean(axis=0) for part in np.array_split(values, _PARTS)])
    usual = np.sqrt(np.mean(np.diff(means[_PARTS // 2 :], axis=0) ** 2, axis=0))
    change = np.abs(means[-_PARTS // 5 :].mean(axis=0) - means[: _PARTS // 5].mean(axis=0))
    return np.asarray(change > WARM_UP * usual)


MOVING = 10.0
"""Largest change from second to second at rest, in units of the usual one."""


def moved(values: Array, interval: float) -> tuple[float, int]:
    """Return the largest change of means over a second, over the usual one, and the second it is at."""
    m = max(round(1.0 / interval), 2)
    means = values[: len(values) // m * m].reshape(-1, m, 3).mean(axis=1)
    steps = np.abs(np.diff(means, axis=0))
    over = steps / (np.median(steps, axis=0) + 1e-12)
    return float(over.max()), int(np.argmax(over.max(axis=1)))

"""Noise figures by an Allan deviation: the likeliest sum of noises, with what else it may be in the deviations.

Points of the curve are averages of the same readings: their covariance follows from the noises' spectra. Readings that
a filter smooths have less noise in short averages: white noise then has a part that falls with the square of the time,
as quantisation has, but is negative; still shorter averages are left out where the rest fits better.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kreisel.geometry.rotation import Array, Indices

FLOOR = 0.664
"""Floor of the Allan deviation over the bias instability B: sqrt(2 ln 2 / pi)."""

_COUNT = 5
"""Noises: quantisation, white, flicker, walk, ramp."""

_MISFIT = 0.05
"""Relative uncertainty of a point besides that of its average. Chosen: no sensor has just the noises of the model."""

_PENALTY = 4.0
"""What another noise must improve the misfit by, to be as likely as none: Bayes' criterion, for fifty points."""

_FREQUENCIES = 3000
"""Points of the integrals over frequency. Chosen: variances change by 3e-3 with twice as many."""

_SMOOTHED = (0, 1)
"""Noises of smoothed readings, at least."""

_SMALL = 5.0
"""White noise over what a filter takes of it, at the shortest averages that are used. Chosen: with ten the noise
density changes by 3e-3 at most (filters of 10 to 80 Hz at 200 Hz), and its deviation grows by a quarter."""

_LEAST = 1e-2
"""Smallest spectrum of smoothed readings, over that of the white noise."""

_ROUNDS = 3
"""Times that the covariance is taken anew from the figures."""

_EVIDENT = 50.0
"""Twice the logarithm of the likelihood ratio from which on there is slow noise. Chosen: of 675 drawn axes of white
noise the largest is 39, for few averages are far from normal; a walk that is twice the white noise at the longest
averages reaches hundreds."""

_FITS, _FEWEST, _LONGEST = 2.0, 10, 100
"""Misfit per degree of freedom up to which a curve is that of the model, points that are left at least, and largest
share of the recording that is left out at the short end, as one over it. Chosen: of drawn noise the misfit is 0.1 to
0.8."""


@dataclass(frozen=True)
class AxisFit:
    """The noises of one axis, in the order quantisation, white noise, flicker noise, walk, ramp.

    Attributes
    ----------
    squares, variances : (5,)
        Squares of the figures and their variances; the first is negative where readings are smoothed.
    likely : (5,)
        How likely each noise is there.
    slow
        How likely there is any of the last three.
    passing : (2,)
        Squares of flicker noise and walk if there is no ramp.
    first
        First point of the curve that is used.
    """

    squares: Array
    variances: Array
    likely: Array
    slow: float
    passing: Array
    first: int


def terms_of(tau: Array) -> Array:
    """Return Allan variances (m, 5) of the noises, by the squares of their figures (IEEE 952)."""
    return np.column_stack([3.0 / tau**2, 1.0 / tau, np.full(tau.size, FLOOR**2), tau / 3.0, 0.5 * tau**2])


def fit_axis(clusters: Indices, interval: float, variance: Array, seconds: float) -> AxisFit:
    """Return the figures of one axis.

    Parameters
    ----------
    clusters : (m,)
        Numbers of readings averaged together.
    variance : (m,)
        Allan variances.
    seconds
        Length of the recording.
    """
    if not (variance > 0.0).all():
        return AxisFit(np.zeros(_COUNT), np.zeros(_COUNT), np.zeros(_COUNT), 0.0, np.zeros(2), 0)
    tau = interval * clusters
    last = min(int(np.searchsorted(tau, seconds / _LONGEST)), max(tau.size - _FEWEST, 0))
    best, least = _fit_from(0, clusters, interval, variance, seconds)
    for first in range(1, last + 1):
        if least <= _FITS:
            break
        fit, misfit = _fit_from(first, clusters, interval, variance, seconds)
        if misfit < 0.5 * least:
            best, least = fit, misfit
    if best.squares[0] < 0.0:  # what a filter takes is not just such a part of shorter averages
        enough = -_SMALL * 3.0 * best.squares[0] / best.squares[1]
        first = min(max(best.first, int(np.searchsorted(tau, enough))), last)
        best, _ = _fit_from(first, clusters, interval, variance, seconds, needed=_SMOOTHED)
    return best


def _fit_from(
    first: int, clusters: Indices, interval: float, variance: Array, seconds: float, *, needed: Collection[int] = ()
) -> tuple[AxisFit, float]:
    """Return the figures by points from one on, and the misfit per degree of freedom.

    needed: noises that are there, however little the points show of them.
    """
    tau: Array = interval * clusters[first:].astype(float)
    used = variance[first:]
    curve = _Curve(clusters[first:], interval, seconds, used, terms_of(tau))
    subsets, _ = _settled(curve, needed)
    fast, slowly = (_settled(curve, needed, slow=slow) for slow in (False, True))
    if fast[0] and slowly[0] and _score(*fast) > _score(*slowly) + _EVIDENT:
        subsets = slowly[0]
    best = min(subsets, key=lambda one: one.score)
    misfit = best.misfit / max(used.size - best.size, 1)
    larger = max(1.0, misfit)
    weights = np.exp([-0.5 * (one.score - best.score) / larger for one in subsets])
    weights /= weights.sum()
    squares = np.array([one.squares for one in subsets])
    spread = np.array([larger * one.variances for one in subsets])
    variances = weights @ (spread + (squares - best.squares) ** 2)
    slow = float(weights @ squares[:, 2:].any(axis=1))
    steady = min((one for one in subsets if one.squares[4] == 0.0), key=lambda one: one.score, default=best)
    return AxisFit(best.squares, variances, weights @ (squares != 0.0), slow, steady.squares[2:4], first), misfit


@dataclass(frozen=True)
class _Curve:
    """Points of a curve, (m,): numbers of readings averaged together, Allan variances, and those of the noises."""

    clusters: Indices
    interval: float
    seconds: float
    variance: Array
    terms: Array

    def covariance(self, squares: Array) -> Array:
        """Return the covariance of the points by noises with squares of figures (5,)."""
        model = self.terms @ squares
        return covariance_of(self.clusters, self.interval, squares, self.seconds) + np.diag((_MISFIT * model) ** 2)


@dataclass(frozen=True)
class _Subset:
    """A fit by some noises only."""

    squares: Array
    variances: Array
    misfit: float
    size: int

    @property
    def score(self) -> float:
        return self.misfit + _PENALTY * self.size


def _settled(curve: _Curve, needed: Collection[int], *, slow: bool | None = None) -> tuple[list[_Subset], Array]:
    """Return fits by sets of noises, and the covariance of points by the best of them.

    slow: whether there is one of the last three in them; either if None.
    """
    C = np.diag((curve.clusters * curve.interval / curve.seconds + _MISFIT**2) * curve.variance**2)
    for k in range(_ROUNDS + 1):
        subsets = _subsets(curve.terms, curve.variance, C, needed)
        subsets = [one for one in subsets if slow is None or bool(one.squares[2:].any()) == slow]
        if k == _ROUNDS or not subsets:
            break
        C = curve.covariance(min(subsets, key=lambda one: one.score).squares)
    return subsets, C


def _score(subsets: list[_Subset], C: Array) -> float:
    """Return minus twice the logarithm of the likelihood of the best of some fits, each with its own covariance."""
    return min(one.score for one in subsets) + float(np.linalg.slogdet(C)[1])


def _subsets(terms: Array, variance: Array, C: Array, needed: Collection[int]) -> list[_Subset]:
    """Return the fits by all sets of noises that have positive squares."""
    scale = np.sqrt(np.diag(C))
    L = np.linalg.cholesky(C / np.outer(scale, scale))
    A, b = np.linalg.solve(L, terms / scale[:, None]), np.linalg.solve(L, variance / scale)
    out = []
    for own in _sets(needed):
        size = np.linalg.norm(A[:, own], axis=0)
        scaled = A[:, own] / size
        x = np.linalg.lstsq(scaled, b, rcond=None)[0] / size
        if np.all(x[own.index(0) + 1 if 0 in own else 0 :] >= 0.0) and (x[0] >= 0.0 or 1 in own):
            squares, variances = np.zeros(_COUNT), np.zeros(_COUNT)
            squares[own] = x
            variances[own] = np.diag(np.linalg.pinv(scaled.T @ scaled)) / size**2
            out.append(_Subset(squares, variances, float(np.sum((A[:, own] @ x - b) ** 2)), len(own)))
    return out


def _sets(needed: Collection[int]) -> Iterator[list[int]]:
    for size in range(1, _COUNT + 1):
        yield from (list(own) for own in combinations(range(_COUNT), size) if set(needed) <= set(own))


def covariance_of(clusters: Indices, interval: float, squares: Array, seconds: float) -> Array:
    """Return the covariance (m, m) of overlapping Allan variances of noises with squares of figures (5,).

    Notes
    -----
    Each is the mean square of the readings after a filter |H|^2 = 2 sin^4(m x) / (m sin x)^2, x = pi f dt; of Gaussian
    noise with the spectrum S the covariance of two is 4 / T times the integral of S^2 |H_i|^2 |H_j|^2 over frequencies
    above zero. A ramp shifts the filtered readings; their mean is uncertain by the readings at both ends.
    """
    q, white, flicker, walk, ramp = squares
    f = np.geomspace(0.02 / seconds, 0.5 / interval, _FREQUENCIES)
    x = np.pi * f * interval
    S = q * (2.0 * np.sin(x)) ** 2 / interval + white + flicker / (2.0 * np.pi * f) + walk / (2.0 * np.pi * f) ** 2
    S = np.maximum(S, _LEAST * white)
    G = 2.0 * np.sin(np.outer(clusters, x)) ** 4 / (clusters[:, None] * np.sin(x)) ** 2
    step = np.gradient(f)
    tau = interval * clusters
    root = G * S * np.sqrt(step) / np.sqrt(seconds - 2.0 * tau)[:, None]
    mean = np.sqrt(0.5 * ramp) * tau
    of_mean = np.sqrt((white * tau + flicker * tau**2) / seconds**2 + 0.5 * walk * tau**2 / seconds)
    return np.asarray(4.0 * (root @ root.T + np.outer(mean * of_mean, mean * of_mean)))

"""Whether a filter's innovations are as large and as independent as it assumes."""

from __future__ import annotations

import itertools
import math
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array

GATE = 1e-6
"""A measurement less probable than one in a million is rejected: equation (20) of docs/explanation/model.md."""

MAX_REJECTED_IN_A_ROW = 6
"""After so many rejected updates in a row the estimate, not the measurement, is assumed to be wrong."""


@cache
def chi_square_bound(tail: float, degrees: float) -> float:
    """Return the bound that a chi-square variable exceeds with the probability `tail`.

    Newton's method on the logarithm of the smaller tail, from the approximation of Wilson and Hilferty (1931). It saves
    the import of SciPy, a tenth of a command.
    """
    a = 0.5 * degrees
    spread = 2.0 / (9.0 * degrees)
    y = a * max(1.0 - spread - NormalDist().inv_cdf(tail) * math.sqrt(spread), 0.05) ** 3
    for _ in range(50):
        below, above = _gamma_tails(a, y)
        density = math.exp((a - 1.0) * math.log(y) - y - math.lgamma(a))
        if tail < 0.5:
            step = above / density * math.log(above / tail)
        else:
            step = -below / density * math.log(below / (1.0 - tail))
        y = max(y + step, 0.1 * y)
        if abs(step) < 1e-14 * y:
            break
    return 2.0 * y


def gate_bounds(degrees: NDArray[np.generic]) -> Array:
    """Return the bound of the normalised innovation squared for each update of so many degrees of freedom, (u,)."""
    bounds = {m: chi_square_bound(GATE, int(m)) for m in np.unique(degrees)}
    return np.array([bounds[m] for m in degrees])


def _gamma_tails(a: float, y: float) -> tuple[float, float]:
    """Return the regularised incomplete gamma functions P(a, y) and Q(a, y) (Abramowitz and Stegun, 6.5.29, 6.5.31)."""
    factor = math.exp(a * math.log(y) - y - math.lgamma(a))
    if y < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > 1e-17 * total:
            n += 1.0
            term *= y / n
            total += term
        return factor * total, 1.0 - factor * total
    # the continued fraction by Lentz's method
    b = y + 1.0 - a
    c, d = 1e300, 1.0 / b
    h = d
    for n in itertools.count(1):
        b += 2.0
        share = -n * (n - a)
        d = 1.0 / (share * d + b)
        c = b + share / c
        h *= c * d
        if abs(c * d - 1.0) < 1e-16 or n > 100_000:
            break
    return 1.0 - factor * h, factor * h


def mean_normalised(nis: Array, degrees: Array) -> float:
    """Return the mean NIS per degree of freedom; 1 for a consistent filter, nan without updates."""
    return float(np.sum(nis) / np.sum(degrees)) if nis.size else float("nan")


def normalised_bounds(degrees: Array, level: float = 0.95) -> tuple[float, float]:
    """Return the interval that contains a consistent filter's mean NIS per degree of freedom at the given level."""
    total = float(np.sum(degrees))
    tail = 0.5 * (1.0 - level)
    return chi_square_bound(1.0 - tail, total) / total, chi_square_bound(tail, total) / total


def autocorrelation(x: Array, lags: int) -> Array:
    """Return the autocorrelation of a series (n,) at lags 0 to `lags`; the mean is taken as zero."""
    variance = float(x @ x)
    if variance == 0.0:
        return np.zeros(lags + 1)
    return np.array([float(x[: x.size - k] @ x[k:]) / variance for k in range(lags + 1)])


def correlation_time(x: Array) -> float:
    """Return the integrated autocorrelation time of a series (n,), in samples; 1 for white noise.

    The mean of n correlated values is as uncertain as that of n / time independent ones. The sum ends
    at six times its own value.

    Notes
    -----
    Sokal, "Monte Carlo methods in statistical mechanics" (1989), section 3.
    """
    rho = autocorrelation(x, min(x.size // 3, 400))
    time = 1.0
    for k in range(1, rho.size):
        time += 2.0 * float(rho[k])
        if k >= 6.0 * time:
            break
    return max(time, 1.0)


def lag_one(whitened: Array, used: NDArray[np.bool_]) -> Array:
    """Return the correlation of each whitened innovation (n, m) with the one before it, (m,); nan without data."""
    out = np.full(whitened.shape[1], np.nan)
    for i in range(whitened.shape[1]):
        x = whitened[used, i]
        x = x[np.isfinite(x)]
        if x.size > 10:
            out[i] = autocorrelation(x, 1)[1]
    return out

"""Whether a filter's innovations are as large and as independent as it assumes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kreisel.geometry.rotation import Array

GATE = 1e-6
"""A measurement less probable than one in a million is rejected: equation (20) of docs/explanation/model.md."""


def chi_square(level: float, degrees: ArrayLike) -> Array:
    """Return the bound below which a chi-square variable lies with the probability `level`."""
    from scipy.special import chdtri  # imported here, because it takes as long as filtering a minute of data

    return np.asarray(chdtri(degrees, 1.0 - level))


def gate_bound(tail: float, degrees: int) -> float:
    """Return the bound that a chi-square variable of a few whole degrees exceeds with the probability `tail`.

    By bisection; the probabilities are finite sums (Abramowitz and Stegun, 26.4.4 and 26.4.5). It saves the import of
    SciPy, 0.2 to 0.3 s of a command.
    """
    low, high = 0.0, 2.0 * (degrees - 4.0 * math.log(tail))
    while high - low > 1e-13 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _exceeds(middle, degrees) > tail else (low, middle)
    return high


def _exceeds(x: float, degrees: int) -> float:
    """Return the probability that a chi-square variable exceeds x."""
    half, odd = 0.5 * x, degrees % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) / (math.gamma(1.5) * half**-0.5 if odd else 1.0) if half > 0.0 else 1.0 - odd
    for k in range(degrees // 2):
        total += term
        term *= half / (k + 1.0 + 0.5 * odd)
    return total


def mean_normalised(nis: Array, degrees: Array) -> float:
    """Return the mean NIS per degree of freedom; 1 for a consistent filter, nan without updates."""
    return float(np.sum(nis) / np.sum(degrees)) if nis.size else float("nan")


def normalised_bounds(degrees: Array, level: float = 0.95) -> tuple[float, float]:
    """Return the interval that contains a consistent filter's mean NIS per degree of freedom at the given level."""
    total = float(np.sum(degrees))
    tail = 0.5 * (1.0 - level)
    return float(chi_square(tail, total) / total), float(chi_square(1.0 - tail, total) / total)


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

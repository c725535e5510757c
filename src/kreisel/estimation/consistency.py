"""Whether a filter's innovations are as large and as independent as it believes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from kreisel.geometry.rotation import Array


def chi_square(level: float, degrees: ArrayLike) -> Array:
    """Return what a chi-square variable stays below with the probability `level`."""
    return np.asarray(chdtri(degrees, 1.0 - level))


def mean_normalised(nis: Array, degrees: Array) -> float:
    """Return the mean NIS per degree of freedom; 1 for a consistent filter, nan without updates."""
    return float(np.sum(nis) / np.sum(degrees)) if nis.size else float("nan")


def normalised_bounds(degrees: Array, level: float = 0.95) -> tuple[float, float]:
    """Return the interval the mean NIS per degree of freedom lies in at the given level if consistent."""
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

"""Robust least squares: Cauchy weights, and their scale."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array

MEDIAN_LENGTH = 1.538
"""Median length of a vector of three independent normal variables of standard deviation one."""


_MEDIAN_SIZE = 0.67449
"""Median size of a normal variable of standard deviation one."""


def normal_scale(values: Array) -> float:
    """Return the standard deviation of normal values of mean zero, any shape, by the median of their sizes."""
    return float(np.median(np.abs(values))) / _MEDIAN_SIZE


def vector_scale(lengths: Array) -> float:
    """Return the standard deviation, for each axis, of normal vectors with lengths (n,), by their median."""
    return float(np.median(lengths)) / MEDIAN_LENGTH


def cauchy_weights(residual: Array, scale: float) -> Array:
    """Return weights 1 / (1 + (residual / scale)^2) of residuals (n,): those far beyond the scale hardly count."""
    return np.asarray(1.0 / (1.0 + (residual / scale) ** 2))

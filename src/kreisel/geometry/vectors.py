"""Vectors in rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def lengths(vectors: Array) -> Array:
    """Return the lengths (...) of vectors (..., n); several times as fast as `np.linalg.norm` for short ones."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def mean_row(values: Array) -> Array:
    """Return the mean of rows (n, k), (k,); the product with a row is faster than a sum along the long axis."""
    return np.asarray(np.full(len(values), 1.0 / max(len(values), 1)) @ values)

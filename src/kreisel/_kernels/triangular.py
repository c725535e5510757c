"""Orthogonal triangularisation of covariance factors."""

from __future__ import annotations

import ctypes

from kreisel._kernels.arrays import Array, TableView
from kreisel._kernels.library import function

_triangularise = function("triangularise", TableView)
_inflate = function("inflate", TableView, ctypes.c_int64, ctypes.c_double)


def triangularise(rows: Array) -> None:
    """Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows.

    Householder's reflections; the diagonal comes out positive.
    """
    if rows.shape[0] < rows.shape[1]:
        raise ValueError(f"rows {rows.shape}; expected as many rows as columns or more")
    _triangularise(rows)


def inflate(upper: Array, index: int, deviation: float) -> None:
    """Add the square of a deviation to the variance of one degree of freedom, in place.

    upper (n, n): a lower triangular factor, transposed. Only the rows from `index` on change.
    """
    if not 0 <= index < upper.shape[0] == upper.shape[1]:
        raise ValueError(f"degree of freedom {index} of a factor {upper.shape}")
    _inflate(upper, index, deviation)

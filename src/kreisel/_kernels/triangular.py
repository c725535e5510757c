"""Orthogonal triangularisation of covariance factors."""

from __future__ import annotations

import ctypes

from kreisel._kernels.compiled import function
from kreisel._kernels.views import (
    Array,
    Indices,
    IndicesView,
    NumbersView,
    TableView,
    check_indices,
    check_lengths,
)

_triangularise = function("triangularise", TableView)
_renew = function("renew", TableView, ctypes.c_int64, ctypes.c_double)
_inflate = function("inflate", TableView, IndicesView, NumbersView)


def triangularise(rows: Array) -> None:
    """Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows.

    Householder's reflections; the diagonal comes out positive.
    """
    if rows.shape[0] < rows.shape[1]:
        raise ValueError(f"rows {rows.shape}; expected as many rows as columns or more")
    _triangularise(rows)


def inflate(upper: Array, degrees: Indices, deviations: Array) -> None:
    """Add the squares of deviations (k,) to the variances of degrees of freedom (k,), in place.

    upper (n, n): a lower triangular factor, transposed, with a diagonal that is not negative.
    """
    n = upper.shape[0]
    check_lengths(upper=(upper, (n, n)), deviations=(deviations, degrees.shape))
    check_indices("degrees", degrees, 0, n)
    _inflate(upper, degrees, deviations)


def renew(upper: Array, first: int, deviation: float) -> None:
    """Replace three degrees of freedom by new ones, with a deviation and independent of all others, in place.

    upper (n, n): as for `inflate`.
    """
    n = upper.shape[0]
    check_lengths(upper=(upper, (n, n)))
    if not 0 <= first <= n - 3:
        raise ValueError(f"degrees of freedom {first} to {first + 2} of {n}")
    _renew(upper, first, deviation)

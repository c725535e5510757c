"""Rotations of a reference against those that gyro readings predict, for the fit of gyro parameters and clock."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kreisel._kernels.compiled import function
from kreisel._kernels.views import Array, Numbers, NumbersView, Pointer, Table, TableView, check_lengths


class RateSignal(NamedTuple):
    """Raw rates of a stretch of readings: as they are, as running means, and integrated from the first sample.

    stamps (n,); rates, smooth, integral (n, 3).
    """

    stamps: Numbers
    rates: Table
    smooth: Table
    integral: Table


_compare_rotations = function(
    "compare_rotations", Pointer(RateSignal), TableView, TableView, NumbersView, *[TableView] * 5
)


def compare_rotations(
    signal: RateSignal, q: Array, K: Array, b: Array, t: Array, rotations: Array
) -> tuple[Array, Array, Array]:
    """Return how a reference's rotations compare with those that readings predict, (m, 3) each.

    The integrated readings over the rotations; the reference's rotation less the predicted one, as a rotation vector;
    the derivative of the predicted one with respect to a shift of the clock.

    Parameters
    ----------
    q, K, b : (n, 4), (3, 3), (3,)
        Attitudes at the samples, those of the rate K w' + b.
    t, rotations : (m, 2), (m, 3)
        Times between which the reference turned, ascending, and its rotation vectors.
    """
    n, m = signal.stamps.size, len(t)
    check_lengths(
        q=(q, (n, 4)), K=(K, (3, 3)), b=(b, (3,)), t=(t, (m, 2)), rotations=(rotations, (m, 3)),
        rates=(signal.rates, (n, 3)), smooth=(signal.smooth, (n, 3)), integral=(signal.integral, (n, 3)),
    )  # fmt: skip
    turned, residual, slope = (np.empty((m, 3)) for _ in range(3))
    _compare_rotations(signal, q, K, b, t, rotations, turned, residual, slope)
    return turned, residual, slope

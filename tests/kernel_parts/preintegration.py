"""The strapdown computation between two updates, for many parameter sets along one path, and its noise."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np

from kreisel._kernels.filter_arguments import Samples
from kreisel._kernels.quadrature import POINTS
from kreisel._kernels.views import (
    Array,
    Pointer,
    Stack,
    StackView,
    Table,
    TableView,
    check_lengths,
    for_columns,
    padded,
)

from .compiled_parts import function


class Increments(NamedTuple):
    """Motion between two samples, one column for each parameter set, seen from the body's attitude at the first.

    Attributes
    ----------
    dq, dv, dp : (4, M), (3, M), (3, M)
    omega_end, alpha_end : (3, M)
        Rate and angular acceleration at the last sample.
    u_end : (3, 3, M)
        Specific force at the sample before the last, at it, and at the one after it.
    u_path, q_path : (c, 4), (4, c)
        Specific force (and a zero) and attitude along the way, of the first column, at the samples from `low` on.
    """

    dq: Table
    dv: Table
    dp: Table
    omega_end: Table
    alpha_end: Table
    u_end: Stack
    u_path: Table
    q_path: Table


_preintegrate = function(
    "preintegrate", ctypes.c_int64, ctypes.c_int64, Pointer(Samples), StackView, StackView, StackView, ctypes.c_int64,
    ctypes.c_int64, Pointer(Increments),
)  # fmt: skip
_noise_covariance = function("noise_covariance", *[ctypes.c_int64] * 3, Pointer(Samples), *[TableView] * 5)


def low_of(signal: Samples, first: int, last: int) -> int:
    """Return the first sample that enters an increment: up to two before its own first."""
    return min(int(signal.base[first]), last - 1)


def preintegrate(signal: Samples, first: int, last: int, rate: Array, force: Array, shared: Array) -> Increments:
    """Return the increments from sample `first` to `last`: equation (8).

    rate (P, 3, m), force (features, 3, m), shared (features, 3, M - m): see `coefficients`; the columns of `shared`
    turn as the first of `rate` does.
    """
    m, others = rate.shape[2], shared.shape[2]
    check_lengths(force=(force, (*force.shape[:2], m)), shared=(shared, (*force.shape[:2], others)))
    if not 0 <= first <= last < signal.stamps.size or last == 0:
        raise ValueError(f"samples {first} to {last} of {signal.stamps.size}")
    count = max(last, int(signal.base[last - 1]) + POINTS - 1) - low_of(signal, first, last) + 1
    M = m + others
    shapes = (4, M), *[(3, M)] * 4, (3, 3, M), (count, 4), (4, count)
    out = Increments(*(for_columns(*shape) for shape in shapes))
    empty = for_columns(*force.shape[:2], 0)
    _preintegrate(first, last, signal, padded(rate), padded(force), padded(shared) if others else empty, m, others, out)
    lengths = (*[m + others] * 6, 4, count)
    return Increments(*(part[..., :length] for part, length in zip(out, lengths, strict=True)))


def noise_covariance(
    signal: Samples, first: int, last: int, every: int, motion: Increments, K_omega: Array, K_a: Array
) -> Array:
    """Return the covariance that sensor noise leaves in attitude, velocity and position, (9, 9): equation (10).

    Seen from the body's attitude at the first sample; attitude errors as left perturbations in that frame.
    `every` samples are taken together. motion: the increments over the span; K_omega, K_a (3, 3).
    """
    Q = np.empty((9, 9))
    check_lengths(K_omega=(K_omega, (3, 3)), K_a=(K_a, (3, 3)))
    _noise_covariance(
        first, last, every, signal, np.ascontiguousarray(motion.u_path), padded(motion.q_path), K_omega, K_a, Q
    )
    return Q

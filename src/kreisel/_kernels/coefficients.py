"""Sensor parameters as factors of a few features of the raw readings, for many parameter sets side by side.

Features of the raw readings:

- of the rate, P = 1 + 3 N: 1, and the powers 1 to N of the three rates;
- of the specific force: the products of two rate features (f <= g), the slopes of the P - 1 powers, and the powers 1 to
  N of the accelerometers' readings.
"""

from __future__ import annotations

import ctypes

import numpy as np

from kreisel._kernels.arrays import Array, IndicesView, StackView, check_lengths, for_columns, padded
from kreisel._kernels.compiled import function

_force_features = function("force_features", ctypes.c_int64, IndicesView)
_rate_coefficients = function("rate_coefficients", StackView, StackView, StackView)
_force_coefficients = function(
    "force_coefficients", *[StackView] * 4, ctypes.c_double, ctypes.c_int64, ctypes.c_int64, StackView
)


def rate_features(order: int) -> int:
    """Return the number of features of the rate, for polynomials of an order N."""
    return 1 + 3 * order


def force_features(order: int) -> int:
    """Return the number of features of the specific force, for polynomials of an order N."""
    out = np.zeros(1, dtype=np.int64)
    _force_features(order, out)
    return int(out[0])


def rate_coefficients(K_omega: Array, k_w: Array) -> Array:
    """Return what equation (1) multiplies the features by, (P, 3, m), from K_omega (3, 3, m) and k_w (N, 3, m)."""
    order, _, m = k_w.shape
    check_lengths(K_omega=(K_omega, (3, 3, m)), k_w=(k_w, (order, 3, m)))
    out = for_columns(rate_features(order), 3, m)
    _rate_coefficients(padded(K_omega), padded(k_w), out)
    return out[..., :m]


def force_coefficients(rate: Array, K_a: Array, k_a: Array, lever_arms: Array, products: float, inside: bool) -> Array:
    """Return what equation (2) multiplies the features by, (features, 3, m).

    rate (P, 3, m), or (P, 3, 1) for all columns; K_a and lever_arms (3, 3, m), k_a (N, 3, m). products is 1, or 0 to
    leave out the products of two rates, as the printed equation (2) does; inside is True where e stands inside the
    parentheses.
    """
    order, _, m = k_a.shape
    common = rate.shape[2] != m
    check_lengths(
        rate=(rate, (rate_features(order), 3, 1 if common else m)), K_a=(K_a, (3, 3, m)), k_a=(k_a, (order, 3, m)),
        lever_arms=(lever_arms, (3, 3, m)),
    )  # fmt: skip
    out = for_columns(force_features(order), 3, m)
    _force_coefficients(
        padded(rate), padded(K_a), padded(k_a), padded(lever_arms), products, int(inside), int(common), out
    )
    return out[..., :m]

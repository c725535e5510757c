"""Sensor parameters as factors of a few features of the readings, for many parameter sets side by side.

Features of the readings:

- of the rate: 1, the three rates, and the features of the gyros' effects;
- of the specific force: the products of two of the first four (f <= g), the slopes of the rates, the accelerometers'
  readings, and the features of their effects.
"""

from __future__ import annotations

import ctypes

from kreisel._kernels.views import Array, StackView, TableView, check_lengths, for_columns, padded

from .compiled_parts import function

RATES = 4
"""Features of the rate without effects."""

FEATURES = 16
"""Features of the specific force without effects."""

_rate_coefficients = function("rate_coefficients", StackView, TableView, StackView, StackView)
_force_coefficients = function(
    "force_coefficients", StackView, StackView, TableView, StackView, StackView, ctypes.c_int64,
    ctypes.c_int64, StackView,
)  # fmt: skip


def rate_coefficients(K_omega: Array, k_w0: Array, effects: Array) -> Array:
    """Return what equation (1) multiplies the features by, (4 + E, 3, m).

    K_omega (3, 3, m), k_w0 (3, m); effects (E, 3, m): what each of their features adds to the reading of each axis.
    """
    m = k_w0.shape[1]
    check_lengths(K_omega=(K_omega, (3, 3, m)), k_w0=(k_w0, (3, m)), effects=(effects, (len(effects), 3, m)))
    out = for_columns(RATES + len(effects), 3, m)
    _rate_coefficients(padded(K_omega), padded(k_w0), padded(effects), out)
    return out[..., :m]


def force_coefficients(
    rate: Array, K_a: Array, k_a0: Array, lever_arms: Array, effects: Array, *, printed: bool
) -> Array:
    """Return what equation (2) multiplies the features by, (16 + E, 3, m).

    rate (P, 3, m), or (P, 3, 1) for all columns; K_a and lever_arms (3, 3, m), k_a0 (3, m), effects (E, 3, m). printed:
    without the products of two rates, and with e outside the parentheses.
    """
    m = k_a0.shape[1]
    common = rate.shape[2] != m
    check_lengths(
        rate=(rate, (max(len(rate), RATES), 3, 1 if common else m)), K_a=(K_a, (3, 3, m)), k_a0=(k_a0, (3, m)),
        lever_arms=(lever_arms, (3, 3, m)), effects=(effects, (len(effects), 3, m)),
    )  # fmt: skip
    out = for_columns(FEATURES + len(effects), 3, m)
    _force_coefficients(
        padded(rate), padded(K_a), padded(k_a0), padded(lever_arms), padded(effects), int(printed),
        int(common), out,
    )  # fmt: skip
    return out[..., :m]

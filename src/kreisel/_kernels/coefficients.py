"""Sensor parameters as factors of a few features of the raw readings, for many parameter sets side by side.

Features of the raw readings:

- of the rate, P = 1 + 3 N: 1, and the powers 1 to N of the three rates; `rate` (P, 3, m) holds what they
  are multiplied by in equation (1);
- of the specific force: the products of two rate features (f <= g), the slopes of the P - 1 powers, and the
  powers 1 to N of the accelerometers' readings; `force` (features, 3, m) likewise for equation (2).
"""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array
from kreisel._kernels.compilation import kernel


@kernel
def force_features(P: int, order: int) -> int:
    """Return the number of features of the specific force."""
    return P * (P + 1) // 2 + P - 1 + 3 * order


@kernel
def rate_coefficients(K_omega: Array, k_w: Array, out: Array) -> None:
    """Write what equation (1) multiplies the features by, (P, 3, m), from K_omega (3, 3, m) and k_w (N, 3, m)."""
    for row in range(3):
        for s in range(out.shape[2]):
            out[0, row, s] = (
                K_omega[row, 0, s] * k_w[0, 0, s]
                + K_omega[row, 1, s] * k_w[0, 1, s]
                + K_omega[row, 2, s] * k_w[0, 2, s]
            )
        for axis in range(3):
            for s in range(out.shape[2]):
                out[1 + axis, row, s] = K_omega[row, axis, s]
            for i in range(1, k_w.shape[0]):
                for s in range(out.shape[2]):
                    out[1 + 3 * i + axis, row, s] = K_omega[row, axis, s] * k_w[i, axis, s]


@kernel
def force_coefficients(
    rate: Array, K_a: Array, k_a: Array, lever_arms: Array, products: float, inside: bool, out: Array
) -> None:
    """Write what equation (2) multiplies the features by, (features, 3, m).

    rate (P, 3, m), or (P, 3, 1) for all columns; K_a and lever_arms (3, 3, m), k_a (N, 3, m). products is 1, or 0 to
    leave out the products of two rates, as the printed equation (2) does; inside is True where e stands inside the
    parentheses.
    """
    m, P = out.shape[2], rate.shape[0]
    slopes = P * (P + 1) // 2
    readings = slopes + P - 1
    axes = np.zeros((3, 3, m))
    field = np.zeros((3, 3, m))
    W = np.empty((P, 3, m))
    one = rate.shape[2] == 1
    for f in range(P):
        for row in range(3):
            for s in range(m):
                W[f, row, s] = rate[f, row, 0 if one else s]
    if inside:
        inverse(K_a, axes)
    x = np.empty((3, m))
    for row in range(3):
        # equation (3): K_a e = sum_ij field_ij ([alpha x] + [omega x]^2)_ij
        for i in range(3):
            for j in range(3):
                for s in range(m):
                    if inside:
                        field[i, j, s] = (
                            K_a[row, 0, s] * axes[0, i, s] * lever_arms[0, j, s]
                            + K_a[row, 1, s] * axes[1, i, s] * lever_arms[1, j, s]
                            + K_a[row, 2, s] * axes[2, i, s] * lever_arms[2, j, s]
                        )
                    else:
                        field[i, j, s] = lever_arms[row, j, s] if i == row else 0.0
        at = 0
        for f in range(P):
            for s in range(m):
                xy = -0.5 * products * (field[0, 1, s] + field[1, 0, s])
                xz = -0.5 * products * (field[0, 2, s] + field[2, 0, s])
                yz = -0.5 * products * (field[1, 2, s] + field[2, 1, s])
                x[0, s] = (field[1, 1, s] + field[2, 2, s]) * W[f, 0, s] + xy * W[f, 1, s] + xz * W[f, 2, s]
                x[1, s] = xy * W[f, 0, s] + (field[0, 0, s] + field[2, 2, s]) * W[f, 1, s] + yz * W[f, 2, s]
                x[2, s] = xz * W[f, 0, s] + yz * W[f, 1, s] + (field[0, 0, s] + field[1, 1, s]) * W[f, 2, s]
            for g in range(f, P):
                twice = 1.0 if f == g else 2.0
                for s in range(m):
                    out[at, row, s] = twice * (x[0, s] * W[g, 0, s] + x[1, s] * W[g, 1, s] + x[2, s] * W[g, 2, s])
                at += 1
            if f > 0:
                for s in range(m):
                    out[slopes + f - 1, row, s] = (
                        (field[1, 2, s] - field[2, 1, s]) * W[f, 0, s]
                        + (field[2, 0, s] - field[0, 2, s]) * W[f, 1, s]
                        + (field[0, 1, s] - field[1, 0, s]) * W[f, 2, s]
                    )
        for axis in range(3):
            for s in range(m):
                out[0, row, s] += K_a[row, axis, s] * k_a[0, axis, s]
                out[readings + axis, row, s] = K_a[row, axis, s]
            for i in range(1, k_a.shape[0]):
                for s in range(m):
                    out[readings + 3 * i + axis, row, s] = K_a[row, axis, s] * k_a[i, axis, s]


@kernel
def inverse(A: Array, out: Array) -> None:
    """Write the inverses, (3, 3, m), of matrices A (3, 3, m)."""
    for s in range(A.shape[2]):
        a = A[1, 1, s] * A[2, 2, s] - A[1, 2, s] * A[2, 1, s]
        b = A[1, 2, s] * A[2, 0, s] - A[1, 0, s] * A[2, 2, s]
        c = A[1, 0, s] * A[2, 1, s] - A[1, 1, s] * A[2, 0, s]
        scale = 1.0 / (A[0, 0, s] * a + A[0, 1, s] * b + A[0, 2, s] * c)
        out[0, 0, s] = scale * a
        out[1, 0, s] = scale * b
        out[2, 0, s] = scale * c
        out[0, 1, s] = scale * (A[0, 2, s] * A[2, 1, s] - A[0, 1, s] * A[2, 2, s])
        out[1, 1, s] = scale * (A[0, 0, s] * A[2, 2, s] - A[0, 2, s] * A[2, 0, s])
        out[2, 1, s] = scale * (A[0, 1, s] * A[2, 0, s] - A[0, 0, s] * A[2, 1, s])
        out[0, 2, s] = scale * (A[0, 1, s] * A[1, 2, s] - A[0, 2, s] * A[1, 1, s])
        out[1, 2, s] = scale * (A[0, 2, s] * A[1, 0, s] - A[0, 0, s] * A[1, 2, s])
        out[2, 2, s] = scale * (A[0, 0, s] * A[1, 1, s] - A[0, 1, s] * A[1, 0, s])

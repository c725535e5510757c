"""Recursions over time that simulation needs."""

from __future__ import annotations

import math

from kreisel._kernels.arrays import Array
from kreisel._kernels.compilation import kernel


@kernel
def drive(step: Array, now: Array, later: Array, u: Array, x: Array) -> None:
    """Write the states x (2, n, m) of m oscillators driven by u (n, m), from standstill.

    x_k+1 = step x_k + now u_k + later u_k+1, with step (2, 2), now and later (2,).
    """
    for k in range(u.shape[0] - 1):
        for j in range(u.shape[1]):
            for i in range(2):
                x[i, k + 1, j] = (
                    step[i, 0] * x[0, k, j] + step[i, 1] * x[1, k, j] + now[i] * u[k, j] + later[i] * u[k + 1, j]
                )


@kernel
def gauss_markov(keep: Array, white: Array, out: Array) -> None:
    """Write a stationary Gauss-Markov process of unit variance, (n, m), from white noise (n, m) and keep (n - 1,)."""
    out[0] = white[0]
    for k in range(keep.size):
        fresh = math.sqrt(1.0 - keep[k] * keep[k])
        for j in range(white.shape[1]):
            out[k + 1, j] = keep[k] * out[k, j] + fresh * white[k + 1, j]

"""Integrals and derivatives of sampled signals at arbitrary stamps, by local quintic and quartic polynomials."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array, Indices
from kreisel._kernels.compilation import kernel

POINTS = 6
"""Samples each interpolating polynomial goes through."""


@kernel
def interval_weights(stamps: Array, base: Indices, single: Array, double: Array) -> None:
    """Write for every sampling interval [t_k, t_k+1] the weights of its two integrals.

    ``sum_i single[k, i] * u[base[k] + i]`` is the integral of u over the interval and
    ``sum_i double[k, i] * u[base[k] + i]`` that of (t_k+1 - t) u, for u the quintic through the six
    samples from ``base[k]`` on. stamps (n,), base (n - 1,), single and double (n - 1, 6).
    """
    x = np.empty(POINTS)
    c = np.empty(POINTS)
    for k in range(stamps.size - 1):
        h = stamps[k + 1] - stamps[k]
        for i in range(POINTS):
            x[i] = (stamps[base[k] + i] - stamps[k]) / h
        for i in range(POINTS):
            # coefficients of the polynomial that is 1 at x_i and 0 at the other nodes
            c[:] = 0.0
            c[0] = 1.0
            degree = 0
            for m in range(POINTS):
                if m == i:
                    continue
                scale = 1.0 / (x[i] - x[m])
                degree += 1
                for j in range(degree, -1, -1):
                    below = c[j - 1] if j > 0 else 0.0
                    c[j] = (below - x[m] * c[j]) * scale
            once = 0.0
            twice = 0.0
            for j in range(POINTS):
                once += c[j] / (j + 1)
                twice += c[j] / ((j + 1) * (j + 2))
            single[k, i] = h * once
            double[k, i] = h * h * twice


@kernel
def integrate_intervals(base: Indices, single: Array, values: Array, out: Array) -> None:
    """Write the integral of every row of values (c, n) over every sampling interval, (c, n - 1).

    base (n - 1,), single (n - 1, 6): see `interval_weights`.
    """
    for row in range(values.shape[0]):
        for k in range(base.size):
            total = 0.0
            for i in range(POINTS):
                total += single[k, i] * values[row, base[k] + i]
            out[row, k] = total


@kernel
def differentiate(stamps: Array, first: Indices, values: Array, out: Array) -> None:
    """Write the derivative, (n, 3), of every column of values (n, 3) at stamps (n,).

    The derivative is that of the quartic through the five samples from ``first[k]`` on, first (n,).
    """
    weight = np.empty(5)
    for k in range(stamps.size):
        centre = k - first[k]
        weight[centre] = 0.0
        for i in range(5):
            if i == centre:
                continue
            numerator = 1.0
            denominator = stamps[first[k] + i] - stamps[k]
            for m in range(5):
                if m in (i, centre):
                    continue
                numerator *= stamps[k] - stamps[first[k] + m]
                denominator *= stamps[first[k] + i] - stamps[first[k] + m]
            weight[i] = numerator / denominator
            weight[centre] -= weight[i]
        for axis in range(3):
            total = 0.0
            for i in range(5):
                total += weight[i] * values[first[k] + i, axis]
            out[k, axis] = total


@kernel
def double_integral(stamps: Array, values: Array, before: Indices, share: Array, out: Array) -> None:
    """Write the double integral (m, k) of values (n, k), sampled at stamps (n,), from the first to chosen moments.

    Moments lie a share (m,) of the interval behind the samples `before` (m,), in ascending order. Values
    are taken as linear between samples, and so is what is written.
    """
    for axis in range(values.shape[1]):
        once = 0.0
        twice = 0.0
        at = 0
        for k in range(stamps.size - 1):
            dt = stamps[k + 1] - stamps[k]
            once_next = once + 0.5 * dt * (values[k, axis] + values[k + 1, axis])
            twice_next = twice + 0.5 * dt * (once + once_next)
            while at < before.size and before[at] == k:
                out[at, axis] = twice + share[at] * (twice_next - twice)
                at += 1
            once = once_next
            twice = twice_next

"""Integrals and derivatives of sampled signals at arbitrary stamps, by local cubic and quartic polynomials."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compilation import kernel


@kernel
def interval_weights(stamps, base, single, double):
    """Write for every sampling interval [t_k, t_k+1] the weights of its two integrals.

    ``sum_i single[k, i] * u[base[k] + i]`` is the integral of u over the interval and
    ``sum_i double[k, i] * u[base[k] + i]`` that of (t_k+1 - t) u, for u the cubic through the four
    samples from ``base[k]`` on. Exact for cubics; on even stamps the single weights are the well-known
    dt/24 (-1, 13, 13, -1).
    """
    x = np.empty(4)
    for k in range(stamps.size - 1):
        h = stamps[k + 1] - stamps[k]
        for i in range(4):
            x[i] = (stamps[base[k] + i] - stamps[k]) / h
        for i in range(4):
            s1 = 0.0
            s2 = 0.0
            s3 = 1.0
            denominator = 1.0
            for m in range(4):
                if m == i:
                    continue
                denominator *= x[i] - x[m]
                s3 *= x[m]
                s2 += x[m] * s1
                s1 += x[m]
            single[k, i] = h / denominator * (1.0 / 4.0 - s1 / 3.0 + s2 / 2.0 - s3)
            double[k, i] = h * h / denominator * (1.0 / 20.0 - s1 / 12.0 + s2 / 6.0 - s3 / 2.0)


@kernel
def integrate_intervals(base, single, values, out):
    """Write the integral of every column of values (n, 3) over every sampling interval, (n - 1, 3)."""
    for k in range(base.size):
        for axis in range(3):
            total = 0.0
            for i in range(4):
                total += single[k, i] * values[base[k] + i, axis]
            out[k, axis] = total


@kernel
def differentiate(stamps, first, values, out):
    """Write the derivative of every column of values (n, 3) at every sample.

    The derivative is that of the quartic through the five samples from ``first[k]`` on.
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

"""Specific force predicted for a unit of each parameter of the accelerometers, integrated twice along a motion."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array, Indices
from kreisel._kernels.compilation import kernel

PARAMETERS = 15
"""Nine couplings, row by row, three offsets, and a lever arm all three have in common."""


@kernel
def at_sample(q: Array, reading: Array, omega: Array, alpha: Array, out: Array) -> None:
    """Write the specific force in r predicted for a unit of each parameter, (45,): x for all, then y, then z.

    Parameters
    ----------
    q, reading, omega, alpha : (4,), (3,), (3,), (3,)
        Attitude q_rb, raw acceleration, rate and angular acceleration of one sample.
    """
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = omega[0], omega[1], omega[2]
    d, e, f = alpha[0], alpha[1], alpha[2]
    for i in range(3):
        if i == 0:
            u, v, n = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
        elif i == 1:
            u, v, n = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
        else:
            u, v, n = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        at = PARAMETERS * i
        for k in range(3):
            out[at + k] = u * reading[k]
            out[at + 3 + k] = v * reading[k]
            out[at + 6 + k] = n * reading[k]
        out[at + 9] = u
        out[at + 10] = v
        out[at + 11] = n
        # minus C ([alpha x] + [omega x]^2)
        out[at + 12] = u * (b * b + c * c) - v * (f + a * b) - n * (a * c - e)
        out[at + 13] = v * (a * a + c * c) - n * (d + b * c) - u * (a * b - f)
        out[at + 14] = n * (a * a + b * b) - u * (e + a * c) - v * (b * c - d)


@kernel
def double_integrals(
    stamps: Array,
    q: Array,
    readings: Array,
    omega: Array,
    alpha: Array,
    before: Indices,
    share: Array,
    out: Array,
) -> None:
    """Write double integrals of what `at_sample` writes from the first stamp to chosen moments, (m, 45).

    stamps (n,), q (n, 4), readings, omega and alpha (n, 3). before and share (m,) give the moments: see
    `quadrature.double_integral`, also for the values between samples.
    """
    columns = 3 * PARAMETERS
    once, twice, rise = np.zeros(columns), np.zeros(columns), np.empty(columns)
    here, ahead = np.empty(columns), np.empty(columns)
    at_sample(q[0], readings[0], omega[0], alpha[0], ahead)
    at = 0
    for k in range(stamps.size - 1):
        for c in range(columns):
            here[c] = ahead[c]
        at_sample(q[k + 1], readings[k + 1], omega[k + 1], alpha[k + 1], ahead)
        half = 0.5 * (stamps[k + 1] - stamps[k])
        for c in range(columns):
            step = half * (here[c] + ahead[c])
            rise[c] = half * (2.0 * once[c] + step)
            once[c] += step
        while at < before.size and before[at] == k:
            for c in range(columns):
                out[at, c] = twice[c] + share[at] * rise[c]
            at += 1
        for c in range(columns):
            twice[c] += rise[c]

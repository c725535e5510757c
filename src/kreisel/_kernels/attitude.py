"""Attitude from rates alone, for signals that are used before any filter runs."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array
from kreisel._kernels.compilation import kernel
from kreisel._kernels.rotation import turn


@kernel
def integrate(stamps: Array, rates: Array, integrals: Array, coefficients: Array, q: Array) -> None:
    """Write the attitudes q (n, 4) that start at the first and turn with the rate, coning included.

    stamps (n,), rates (P, n), integrals (P, n - 1): see `arrays.PreparedReadings`; coefficients (P, 3): see
    `coefficients`.
    """
    column = np.empty((4, 1))
    theta = np.empty((3, 1))
    omega = np.zeros(3)
    ahead = np.zeros(3)
    for i in range(4):
        column[i, 0] = q[0, i]
    for k in range(stamps.size):
        for i in range(3):
            omega[i] = ahead[i]
            ahead[i] = 0.0
            for f in range(rates.shape[0]):
                ahead[i] += coefficients[f, i] * rates[f, k]
        if k == 0:
            continue
        dt = stamps[k] - stamps[k - 1]
        for i in range(3):
            theta[i, 0] = 0.0
            for f in range(rates.shape[0]):
                theta[i, 0] += coefficients[f, i] * integrals[f, k - 1]
        theta[0, 0] += dt * dt / 12.0 * (omega[1] * ahead[2] - omega[2] * ahead[1])
        theta[1, 0] += dt * dt / 12.0 * (omega[2] * ahead[0] - omega[0] * ahead[2])
        theta[2, 0] += dt * dt / 12.0 * (omega[0] * ahead[1] - omega[1] * ahead[0])
        turn(column, theta, 1.0)
        for i in range(4):
            q[k, i] = column[i, 0]

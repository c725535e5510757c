"""Attitude from rotation steps, for signals that are used before any filter runs."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compilation import kernel
from kreisel._kernels.rotation import turn


@kernel
def accumulate(steps, q):
    """Write the attitudes q (n, 4) that start at the first and are turned by steps (n - 1, 3) on their right."""
    column = np.empty((4, 1))
    theta = np.empty((3, 1))
    for i in range(4):
        column[i, 0] = q[0, i]
    for k in range(steps.shape[0]):
        for i in range(3):
            theta[i, 0] = steps[k, i]
        turn(column, theta, 1.0)
        for i in range(4):
            q[k + 1, i] = column[i, 0]

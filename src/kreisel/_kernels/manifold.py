"""Small changes of a state made of vectors and rotations, and the way back."""

from __future__ import annotations

import numpy as np

from kreisel._kernels import rotation
from kreisel._kernels.arrays import Array, Indices
from kreisel._kernels.blocks import place
from kreisel._kernels.compilation import kernel

DEGREE, DEGREES, STORED, ROTATION = range(4)
"""Columns of a table of parts: first degree of freedom, how many, first stored number, whether a rotation."""


@kernel
def plus(parts: Indices, x: Array, change: Array, out: Array) -> None:
    """Write the states (size, m) that lie changes (degrees, m) away from the state x (size,).

    parts (p, 4): see `DEGREE`. Rotations are stored as quaternions and changed on their right.
    """
    m = change.shape[1]
    for i in range(parts.shape[0]):
        d = parts[i, DEGREE]
        at = parts[i, STORED]
        if parts[i, ROTATION] == 0:
            for j in range(parts[i, DEGREES]):
                for s in range(m):
                    out[at + j, s] = x[at + j] + change[d + j, s]
            continue
        theta = np.zeros((3, m))
        place(change[d : d + parts[i, DEGREES]], 0, 0, theta)
        rotation.plus(x[at : at + 4].reshape(4, 1), theta, out[at : at + 4])


@kernel
def minus(parts: Indices, states: Array, x: Array, out: Array) -> None:
    """Write the changes (degrees, m) that lead from the state x (size,) to states (size, m); parts as for `plus`."""
    m = states.shape[1]
    for i in range(parts.shape[0]):
        d = parts[i, DEGREE]
        at = parts[i, STORED]
        if parts[i, ROTATION] == 0:
            for j in range(parts[i, DEGREES]):
                for s in range(m):
                    out[d + j, s] = states[at + j, s] - x[at + j]
            continue
        theta = np.empty((3, m))
        rotation.minus(states[at : at + 4], x[at : at + 4].reshape(4, 1), theta)
        place(theta[: parts[i, DEGREES]], d, 0, out)

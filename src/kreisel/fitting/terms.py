"""Further terms of readings and poses, outside the state: known functions with unknown amplitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices

GYRO_ROWS, ACCEL_ROWS, POSE_ROWS = range(3), range(3, 6), range(6, 12)
"""What a term adds to: rates and accelerations, as their offsets do; position in r and rotation of the true pose."""


@dataclass(frozen=True)
class Terms:
    """Terms of readings and poses: products of functions and unknown amplitudes, one of each term.

    Attributes
    ----------
    functions : (u, k)
        Values of functions: of the readings, on average since the update before; of poses, at the updates.
    function : (m,)
        Which function a term has.
    row : (m,)
        What it adds to: one of `GYRO_ROWS` or `ACCEL_ROWS`, or, after these, a direction of poses.
    directions : (u, 6, d)
        What the true pose has more than the reported for a unit of each direction: position in r, rotation as a right
        perturbation. The first six are the components themselves.
    """

    functions: Array
    function: Indices
    row: Indices
    directions: Array

    @property
    def count(self) -> int:
        """The number of terms."""
        return int(self.row.size)


@dataclass(frozen=True)
class Linearisation:
    """What data say of terms outside the state, to first order about a fit without them, all parameters estimated.

    Attributes
    ----------
    change : (n, m)
        Of the fit's parameters, for unit amplitudes.
    information : (m, m)
        About the amplitudes.
    score : (m,)
        Gradient of the log-likelihood at zero amplitudes.
    part_information : (p, m, m), part_scores : (p, m)
        What each of the recording's parts adds to them, given those before it.
    misfit, degrees
        Sum of normalised innovations squared without terms, and the number it is expected to equal.
    """

    change: Array
    information: Array
    score: Array
    part_information: NDArray[np.float32]
    part_scores: Array
    misfit: float
    degrees: float

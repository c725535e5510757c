"""Further terms of readings and poses, outside the state: known functions with unknown amplitudes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices

GYRO_ROWS, ACCEL_ROWS, POSE_ROWS = range(3), range(3, 6), range(6, 12)
"""What a term adds to: rates and accelerations, as their offsets do; position in r and rotation of the true pose."""

OFFSET_ROWS = {"gyro_offset": GYRO_ROWS, "accel_offset": ACCEL_ROWS}
"""The groups that terms of readings are changes of, with their rows."""


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
    moments : (u, k), or None
        How much further than by their mean functions move the position, s^2: double integrals since the update before.
    axes : (u, 3, 3)
        What a unit of each accelerometer's reading is in r.
    """

    functions: Array
    function: Indices
    row: Indices
    directions: Array
    moments: Array | None = None
    axes: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    @property
    def count(self) -> int:
        """The number of terms."""
        return int(self.row.size)

    def some(self, which: Indices) -> Terms:
        """Return some of the terms."""
        return replace(self, function=self.function[which], row=self.row[which])


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
    innovations : (u, 9, m)
        What unit amplitudes add to the whitened predictions, if it was asked for.
    """

    change: Array
    information: Array
    score: Array
    part_information: NDArray[np.float32]
    part_scores: Array
    misfit: float
    degrees: float
    innovations: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 9, 0), np.float32))


@dataclass(frozen=True)
class Scores:
    """Gradients of the log-likelihood at zero amplitudes, and what they would be by chance.

    Attributes
    ----------
    value : (m,)
        Of the data.
    draws : (r, m)
        Of data drawn as the model says.
    """

    value: Array
    draws: Array

"""Accuracy of an arm's poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class PoseAccuracy:
    """Error of the tool's reported poses, rms over poses: m and rad.

    Errors of the base and tool frames are left out: the user sets these frames, and an IMU cannot observe them.
    """

    position: float
    orientation: float

    @classmethod
    def of(cls, square: Array) -> PoseAccuracy:
        """Return the accuracy from squared pose errors (k, 6)."""
        return cls(*(float(np.sqrt(np.mean(np.sum(part, axis=1)))) for part in (square[:, :3], square[:, 3:])))

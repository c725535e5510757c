"""Accuracy of an arm's poses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PoseAccuracy:
    """Error of the tool's reported poses, rms over poses: m and rad.

    Errors of the base and tool frames are left out: the user sets these frames, and an IMU cannot observe them.
    """

    position: float
    orientation: float

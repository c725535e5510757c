"""How accurate an arm's poses are."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PoseAccuracy:
    """How far the tool stands from its reported poses, rms over poses: m and rad.

    Apart from where base and tool frame lie: those the user sets, and no IMU sees.
    """

    position: float
    orientation: float

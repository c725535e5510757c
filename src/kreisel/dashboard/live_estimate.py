"""What is known of a recording while it is made."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class LiveEstimate:
    """What is known after so many seconds of recording.

    Attributes
    ----------
    seconds
        Of IMU readings.
    names, values, deviations : (n,)
        Parameters by the paths they have in the result; empty where nothing could be estimated.
    said
        Why there is no estimate, what is wrong with it, or that it is accepted.
    """

    seconds: float
    names: tuple[str, ...]
    values: Array
    deviations: Array
    accepted: bool
    said: str
    calibration: Calibration | None = None

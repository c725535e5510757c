"""An estimate from a recording while it is being made."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class LiveEstimate:
    """The estimate after `seconds` seconds of recording.

    Attributes
    ----------
    seconds
        Duration of the IMU readings.
    names, values, deviations : (n,)
        Parameters, named by their paths in the result; empty if nothing could be estimated.
    summary
        The verdict as text: why there is no estimate, why it is rejected, or that it is accepted.
    """

    seconds: float
    names: tuple[str, ...]
    values: Array
    deviations: Array
    accepted: bool
    summary: str
    calibration: Calibration | None = None

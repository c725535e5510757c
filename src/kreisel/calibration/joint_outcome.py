"""A calibration from several recordings with all intermediate results, for reports."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.calibration.outcome import Outcome
from kreisel.calibration.repeatability import Repeated
from kreisel.calibration.result import Calibration
from kreisel.recording.recording import DataWarning


@dataclass(frozen=True)
class Joint:
    """One calibration from several recordings, with what led to it.

    Attributes
    ----------
    calibration
        The result, in the body b of the first recording used.
    names, outcomes
        The recordings used, and the calibration of each alone.
    repeated
        The comparison of these.
    warnings
        What to know about the recordings, and about all of them.
    """

    calibration: Calibration
    names: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    repeated: tuple[Repeated, ...]
    warnings: tuple[DataWarning, ...]

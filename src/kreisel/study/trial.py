"""Outcome of one trial of a study."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Trial:
    """Outcome of one trial.

    Attributes
    ----------
    number
        Number of the trial.
    names
        Names of the judged parameters.
    error, deviation : (n,)
        Estimate less truth, and the calibration's standard deviation, SI.
    nees
        Error squared, normalised by the covariance of all judged parameters; n is expected.
    nis_path, nis_standstill
        Mean normalised innovations squared.
    accepted, seconds
        Verdict, and the duration of the calibration.
    failure
        The error message; empty if there was no error.
    """

    number: int
    names: tuple[str, ...]
    error: Array
    deviation: Array
    nees: float
    nis_path: float
    nis_standstill: float
    accepted: bool
    seconds: float
    failure: str = ""

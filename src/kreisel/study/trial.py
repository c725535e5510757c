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
        Which.
    names
        Of the parameters judged.
    error, deviation : (n,)
        Estimate less truth, and what the calibration says of it, SI.
    nees
        Error squared, normalised by the covariance of all parameters judged; n is expected.
    nis_path, nis_standstill
        Mean normalised innovations squared.
    accepted, seconds
        Verdict, and how long the calibration took.
    failure
        What went wrong; empty if nothing did.
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

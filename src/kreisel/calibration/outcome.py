"""A calibration with all intermediate results, for reports and further study."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.calibration.evidence import CrossValidation, LackOfFit, Split, SplitHalves
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import Consistency, Verdict
from kreisel.model.problem import Problem
from kreisel.preparation.preparation import Preparation
from kreisel.recording.recording import DataWarning, Recording
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.observability import Observability


@dataclass(frozen=True)
class Outcome:
    """A calibration with all intermediate results, for reports and further study."""

    recording: Recording
    preparation: Preparation
    problem: Problem
    estimate: Estimate
    observability: Observability
    consistency: Consistency
    halves: SplitHalves | None
    verdict: Verdict
    warnings: tuple[DataWarning, ...]
    calibration: Calibration
    lack: LackOfFit | None = None
    cross: CrossValidation | None = None
    splits: tuple[Split, ...] = ()

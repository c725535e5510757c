"""Trials of a calibration in the virtual cell.

The caller distributes trials over machines. Trial k depends on the cell and on k only, so that any
distribution gives the same numbers.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.errors import KreiselError
from kreisel.fitting.stored_state import stored_state
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.trial import Trial
from kreisel.study.truth import judged, true_parameters


def run_trial(cell: Cell, settings: CalibrationSettings, number: int) -> Trial:
    """Return the outcome of one trial; a calibration that fails is an outcome too."""
    truth, recording = simulate(cell, Path(f"trial {number}"), trial=number)
    began = time.perf_counter()
    try:
        outcome = run_calibration(recording, settings)
    except KreiselError as failed:
        empty = np.empty(0)
        return Trial(number, (), empty, empty, np.nan, np.nan, np.nan, False, time.perf_counter() - began, str(failed))
    seconds = time.perf_counter() - began
    problem, run = outcome.estimate.problem, outcome.estimate.run
    true = true_parameters(truth, recording, problem, run.parameters)
    which, names = judged(problem)
    error = problem.layout.minus(run.belief.mean[:, None], stored_state(problem, true))[which, 0]
    P = run.belief.covariance[np.ix_(which, which)]
    deviation = np.sqrt(np.diag(P))
    scaled = np.linalg.solve(np.linalg.cholesky(P / np.outer(deviation, deviation)), error / deviation)
    facts = outcome.consistency
    return Trial(
        number,
        names,
        error,
        deviation,
        float(scaled @ scaled),
        facts.nis_path,
        facts.nis_standstill,
        outcome.verdict.accepted,
        seconds,
    )

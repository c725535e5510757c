"""Estimators side by side in the virtual cell: how far from the truth they may start, what their deviations are worth.

Every run is a recording, calibrated by each estimator from first values that are wrong by a known amount. Only the
usual parameters are estimated, and nothing is judged: what is compared is the estimators alone.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.errors import EstimationError, KreiselError
from kreisel.fitting.fit import Estimator, Fit
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.rotation import exp, matrix
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.method_rows import CELLS, MOTIONS, SEEDS, MethodRow, words_of
from kreisel.study.situations import BASES
from kreisel.study.truth import judged, true_parameters
from kreisel.units import DEG
from kreisel.validation.checks import check_streams

MAX_PASSES, SETTLED = 8, 0.2
"""Passes after which a run ends, and change of every parameter, in deviations, below which it ends before."""


def run_numbered(seconds: float, methods: Sequence[str], number: int) -> tuple[MethodRow, ...]:
    """Return a row for each estimator; they depend on the number alone, but for the time."""
    place, seed = divmod(number, SEEDS)
    device, reference, first_errors, motion = CELLS[place]
    content: dict[str, Any] = {table: dict(values) for table, values in BASES[reference].items()}
    content["imu"] = {"grade": device, "gyro_g_sensitivity_sd": 0.0, "gyro_g_squared_sd": 0.0}
    content["motion"] = {"range_share": MOTIONS[motion]}
    cell = Cell.model_validate({**content, "seed": seed, "seconds": seconds})
    truth, recording = simulate(cell, Path(f"{device}-{reference}-{motion}-{seed}"))
    recording = check_streams(recording)
    settings = CalibrationSettings()
    problem = build_problem(prepare_recording(recording, settings), settings)
    angle, share = first_errors
    first = wrong_by(problem, angle * DEG, share, np.random.default_rng((seed, place)))
    which, _ = judged(problem)
    rows = []
    for name in methods:
        known = (device, reference, words_of(first_errors), motion, name, seed)
        began = time.perf_counter()
        try:
            fit, passes = settled(first, ESTIMATORS[name])
        except KreiselError as failed:
            rows.append(MethodRow(*known, np.nan, np.nan, 0, time.perf_counter() - began, str(failed)))
            continue
        seconds_taken = time.perf_counter() - began
        true = true_parameters(truth, recording, problem, fit.parameters)
        error = problem.layout.minus(fit.belief.mean[:, None], stored_state(problem, true))[which, 0]
        score = error / fit.belief.standard_deviation[which]
        worst, ratio = float(np.abs(score).max()), float(np.sqrt(np.mean(score**2)))
        rows.append(MethodRow(*known, worst, ratio, passes, seconds_taken))
    return tuple(rows)


def wrong_by(problem: Problem, angle: float, share: float, rng: np.random.Generator) -> Problem:
    """Return the problem whose first matrices are wrong by a rotation and scale factors, and say so.

    angle, share: deviations of each component of the rotation vector, rad, and of each scale factor.
    """
    prior, sensors = problem.prior, problem.prior.start.sensors
    turn = matrix(exp(angle * rng.normal(size=3)))
    moved = {
        name: turn @ getattr(sensors, name) @ np.diag(1.0 + share * rng.normal(size=3)) for name in ("K_omega", "K_a")
    }
    start: CellParameters = replace(prior.start, sensors=replace(sensors, **moved))
    wide = (angle**2 + share**2) * np.eye(9)
    own = {g: wide for g in ("gyro_cross_coupling", "accel_cross_coupling") if g in problem.layout}
    return replace(problem, prior=replace(prior, start=start, start_covariance=prior.start_covariance | own))


def settled(problem: Problem, estimator: Estimator) -> tuple[Fit, int]:
    """Return the fit of a problem that further passes do not change, and the number of passes.

    Raises
    ------
    EstimationError
        If it still changes after `MAX_PASSES`.
    """
    fit = estimator.fit(problem, gate=100.0)
    n = len(problem.parameter_names)
    for count in range(1, MAX_PASSES):
        again = estimator.refit(problem, fit, gate=100.0)
        moved = problem.layout.minus(again.belief.mean[:, None], fit.belief.mean)[:n, 0]
        fit = again
        if np.all(np.abs(moved) < SETTLED * fit.belief.standard_deviation[:n]):
            return fit, count + 1
    raise EstimationError(f"still changes after {MAX_PASSES} passes")

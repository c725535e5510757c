"""The posterior Cramer-Rao bound along the true motion: the best accuracy of any estimator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Errors
from kreisel.simulation.owner_statements import recording_settings
from kreisel.study.truth import judged, true_parameters


@dataclass(frozen=True)
class Bound:
    """Smallest possible standard deviations (n,) of the named parameters, SI."""

    names: tuple[str, ...]
    deviation: Array


def cramer_rao_bound(cell: Cell, settings: CalibrationSettings, number: int) -> Bound:
    """Return the bound for one trial's motion and parameters.

    The motion is simulated without errors and noise; the information of readings and poses, with the
    noise of the cell, is then computed by a linearisation about the truth itself. For errors as small
    as these the bound is that of the linear problem (Tichavsky, Muravchik and Nehorai 1998, section III).
    """
    silent = cell.model_copy(
        update={
            "imu": cell.imu.model_copy(update={"noise": False}),
            "errors": Errors.none(),
            "reference": cell.reference.model_copy(update={"jitter": 0.0}),
        }
    )
    truth, recording = simulate(silent, Path(f"bound {number}"), trial=number)
    recording = replace(recording, settings=recording_settings(cell, truth.actual))
    settings = replace(settings, sigma_points="linear")
    problem = build_problem(prepare_recording(recording, settings), settings)
    true = true_parameters(truth, recording, problem, problem.prior.start)
    run = KalmanFilter().begin(problem, true, first_belief(problem, true), gate=np.inf)
    which, names = judged(problem)
    return Bound(names, run.belief.standard_deviation[which])

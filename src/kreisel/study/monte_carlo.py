"""Trials of a calibration in the virtual cell, and what many of them say together.

How trials are spread over machines is somebody else's business: a map is injected. Trial k depends on
the cell and on k alone, so that any map gives the same numbers.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.filter_run import stored_state
from kreisel.calibration.parameters import CellParameters, RobotParameters
from kreisel.calibration.problem import Problem
from kreisel.calibration.settings import CalibrationSettings
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array, Indices, apply, conjugate, from_two_vectors, multiply, nearest_rotation
from kreisel.recording import Recording
from kreisel.simulation import Cell, Truth, simulate
from kreisel.synchronization import Clock

JUDGED = ("gyroscope", "accelerometer", "timing", "alignment.tilt")
"""Parameters whose names begin so are judged; north and the robot's errors hang on their priors."""


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


def judged(problem: Problem) -> tuple[Indices, tuple[str, ...]]:
    """Return which degrees of freedom are judged, and the names of their parameters."""
    chosen = [(i, name) for i, name in enumerate(problem.parameter_names) if name.startswith(JUDGED)]
    return np.array([i for i, _ in chosen], dtype=np.int64), tuple(name for _, name in chosen)


def true_parameters(truth: Truth, recording: Recording, problem: Problem, found: CellParameters) -> CellParameters:
    """Return the truth in the terms of a problem: its layout, its clock, and north as it was found."""
    sensors = truth.sensors
    if problem.reference.quaternions is None:
        # Positions do not show how b is turned: it takes the gyros' axes as far as they are square.
        C = nearest_rotation(sensors.K_omega).T
        sensors = replace(
            sensors, K_omega=C @ sensors.K_omega, K_a=C @ sensors.K_a, lever_arms=sensors.lever_arms @ C.T
        )
    order = problem.settings.polynomial_order
    k_w, k_a = (np.vstack([k, np.zeros((order, 3))])[:order] for k in (sensors.k_w, sensors.k_a))
    q_rn, north = _alignment(truth, found)
    apart = Clock(0.0).offset(int(recording.imu.stamps_ns[0]), int(problem.reference.stamps_ns[0]))
    start = truth.time_offset - apart
    robot = RobotParameters.none(problem.joints)
    if problem.joints:
        robot = RobotParameters(truth.arm.placement, robot.gears, truth.arm.compliance)
    return CellParameters(
        type(sensors)(sensors.K_omega, k_w, sensors.K_a, k_a, sensors.lever_arms),
        q_rn, north, float(np.linalg.norm(truth.gravity_r)), start, truth.time_skew, robot,
    )  # fmt: skip


def _alignment(truth: Truth, found: CellParameters) -> tuple[Array, Array]:
    """Return q_rn with the true down, reached from the one found by a turn without part about down, and north."""
    down = apply(conjugate(found.q_rn), truth.gravity_r)
    turn = from_two_vectors(np.array([0.0, 0.0, 1.0]), down)
    return multiply(found.q_rn, turn), found.north

"""The filter's problem of a small cell, a run over it, and beliefs and histories that are made up."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.estimation.belief import Belief
from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import stored_state
from kreisel.fitting.update_history import History
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.assumed_noise import GaussMarkov
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.model.problem import Problem, with_groups
from kreisel.preparation.build_problem import INTERVALS, build_problem
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.recording.recording import Recording
from kreisel.refinement.estimate import Estimate

from .small_cell import Truth, simulate

SECONDS, RATE, SEED = 40.0, 100.0, 3


@cache
def recorded(seconds: float = SECONDS) -> tuple[Truth, Recording]:
    """A small recording, and its truth."""
    return simulate(np.random.default_rng(SEED), seconds, Path("small"), imu_rate=RATE)


@cache
def prepared(seconds: float = SECONDS) -> Preparation:
    return prepare_recording(recorded(seconds)[1], CalibrationSettings())


@cache
def small_problem() -> Problem:
    return build_problem(prepared(), CalibrationSettings(update_interval=INTERVALS["robot"]))


@cache
def small_run() -> Fit:
    """One pass over the small problem, with the stated prior."""
    return KalmanFilter().fit(small_problem())


@cache
def plain_run() -> Fit:
    """One run of the filter over the small problem, as it leaves it."""
    return run_filter(small_problem(), small_problem().prior.start)


@cache
def camera_problem() -> Problem:
    """The same recording as one of motion capture: no frames that err, and noise just as it was simulated."""
    recording = recorded()[1]
    reference = recording.settings.reference.model_copy(update={"kind": "mocap"})
    stated = replace(recording, settings=recording.settings.model_copy(update={"reference": reference}))
    settings = CalibrationSettings(update_interval=0.24)
    return build_problem(prepare_recording(stated, settings), settings)


@cache
def calibrated() -> Outcome:
    """The calibration of the small recording, with all that led to it."""
    return run_calibration(recorded()[1], CalibrationSettings(), budget=True)


class GivenFits:
    """An estimator whose fits are made up: one after another, whatever it is asked."""

    name = "given"

    def __init__(self, fits):
        self._waiting = iter(fits)

    def refit(self, *_, **__):
        return next(self._waiting)


def estimate_of(problem: Problem, run: Fit, **changed: object) -> Estimate:
    """An estimate of one pass without anything to say."""
    return replace(Estimate(problem, run, KalmanFilter(), 1, 1.0, 1.0, 0.0, ()), **changed)


def moved_by(problem: Problem, parameters: CellParameters, change: np.ndarray) -> CellParameters:
    """Return parameters a change (n,) away."""
    layout = problem.layout
    wide = np.zeros(layout.degrees)
    wide[: change.size] = change
    state = layout.plus(stored_state(problem, parameters), wide[:, None])[:, 0]
    values = {g: parameters.stored(g) for g in GROUPS} | {g: state[layout.stored(g)].copy() for g in problem.groups}
    return CellParameters.from_stored(values)


def random_belief(problem: Problem, rng: np.random.Generator, sd: float = 1e-3) -> Belief:
    """A belief about the prior's start with a full random factor of about these deviations."""
    n = problem.layout.degrees
    factor = sd * (np.tril(rng.normal(0.0, 0.3, (n, n)), -1) + np.diag(rng.uniform(0.5, 2.0, n)))
    return Belief(stored_state(problem, problem.prior.start), factor)


def with_fit(preparation: Preparation, **changed: object) -> Preparation:
    """Return the preparation with another fit of the rates."""
    return replace(preparation, rate_fit=replace(preparation.rate_fit, **changed))


def with_noise(problem: Problem, **changed: object) -> Problem:
    """Return the problem with other assumptions about its noise."""
    return replace(problem, noise=replace(problem.noise, **changed))


def with_drifts(problem: Problem, drift: GaussMarkov) -> Problem:
    """Return the problem with a passing change of the gyros' offsets, and nothing that walks."""
    known = {"gyro_gauss_markov": drift.size**2 * np.eye(3)}
    return with_noise(
        with_groups(problem, ("gyro_gauss_markov",), known), gauss_markov={"gyro_gauss_markov": drift}, offset_walk={}
    )


def history(u: int, **columns: np.ndarray) -> History:
    """A history of so many updates on the path, all used, of no parameters; what is not given is zero."""
    width = {
        "parameters": (u, 0), "deviations": (u, 0),
        "passing": (u, 6), "late": (u, 2), "correction": (u, 6), "correction_variance": (u, 6),
        **dict.fromkeys(("whitened", "innovation", "residual", "noise_variance"), (u, 9)),
    }  # fmt: skip
    made = {f.name: np.zeros(width.get(f.name, (u,))) for f in fields(History)}
    made["seconds"] = np.arange(u, dtype=float)
    made["at_standstill"], made["used"] = np.zeros(u, dtype=bool), np.ones(u, dtype=bool)
    made["degrees"] = np.full(u, 6.0)
    return History(**(made | columns))

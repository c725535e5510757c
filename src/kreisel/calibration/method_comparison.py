"""One recording calibrated by several estimators, kreisel's and a user's own."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout

import numpy as np

from kreisel._kernels.strapdown_pass import strapdown_seconds
from kreisel.calibration.array_checks import check_recording
from kreisel.calibration.by_method import ByMethod, Comparison, parameters_in
from kreisel.calibration.calibrate import ESTIMATORS, run_calibration
from kreisel.calibration.cross_validation import drift_of, first_part
from kreisel.calibration.evidence import Drift
from kreisel.calibration.own_code import said
from kreisel.calibration.own_estimator import (
    Estimates,
    Estimator,
    checked,
    derived_of_own,
    measurements_of,
    parameters_of_own,
)
from kreisel.errors import KreiselError, SettingsError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import Problem
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.progress import Progress, shown
from kreisel.recording.recording import Recording
from kreisel.tasks import Executor, sequential

_NAVIGATOR = ESTIMATORS["ekf"]
"""What navigates with the parameters of own estimators."""


def compare_methods(
    recording: Recording,
    methods: Sequence[str | Estimator],
    progress: Progress | bool | None = None,
    executor: Executor = sequential,
    truth: Mapping[str, float] | None = None,
) -> Comparison:
    """Return what each of some estimators finds in a recording.

    Parameters
    ----------
    methods
        Names of kreisel's, and own ones; see `own_estimator.Estimator`.
    progress
        As of `kreisel.calibrate`.
    truth
        True values by the parameters' paths in the result file, where they are known.
    """
    check_recording(recording)
    methods = [methods] if isinstance(methods, str) else list(methods)
    if not methods:
        raise SettingsError("methods: none is given, expected names of estimators, or own ones")
    with shown(progress) as show:
        found = tuple(
            _calibrated(recording, one, show, executor) if isinstance(one, str) else _own(recording, one, executor)
            for one in methods
        )
    imu = recording.imu
    return Comparison(
        recording.path.name, found, strapdown_seconds(imu.rates, imu.accelerations, imu.interval), truth or {}
    )


def _calibrated(recording: Recording, name: str, progress: Progress | None, executor: Executor) -> ByMethod:
    settings, began = CalibrationSettings(estimator=name), time.perf_counter()
    try:
        outcome = run_calibration(recording, settings, progress, executor=executor, validate=True)
    except KreiselError as error:
        return ByMethod(name, time.perf_counter() - began, error=str(error))
    drift = None if outcome.cross is None else _rms(outcome.cross.calibrated)
    return ByMethod.of(name, time.perf_counter() - began, outcome.calibration, drift)


def _own(recording: Recording, own: Estimator, executor: Executor) -> ByMethod:
    """Return what an own estimator finds; whatever it raises is its error."""
    settings, began = CalibrationSettings(), time.perf_counter()
    try:
        preparation = prepare_recording(recording, settings, executor)
        problem = build_problem(preparation, settings)
        found = _asked(own, preparation, problem)
        seconds = time.perf_counter() - began
        derived = derived_of_own(parameters_of_own(preparation, problem, found).sensors, found)
    except KreiselError as error:
        return ByMethod(own.name, time.perf_counter() - began, error=str(error))
    except (Exception, SystemExit) as error:
        return ByMethod(own.name, time.perf_counter() - began, error=said(error))
    return ByMethod(
        own.name,
        seconds,
        parameters_in(found.values),
        parameters_in(found.deviations),
        derived,
        drift=_own_drift(own, preparation, problem),
    )


def _asked(own: Estimator, preparation: Preparation, problem: Problem, until: float = np.inf) -> Estimates:
    with redirect_stdout(sys.stderr):  # what it prints is no part of the comparison
        found = own.estimate(measurements_of(preparation, problem, until))
    return checked(found)


def _own_drift(own: Estimator, preparation: Preparation, problem: Problem) -> tuple[float, float] | None:
    """Return the drift on the last part of a recording by what an own estimator finds in the first, if it does."""
    cut, until = first_part(problem)
    try:
        known = parameters_of_own(preparation, problem, _asked(own, preparation, problem, until))
        return _rms(drift_of(_NAVIGATOR.navigate, problem, cut, known))
    except Exception:
        return None


def _rms(drift: Drift) -> tuple[float, float]:
    position, orientation = (
        float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
        for values in (drift.position, drift.attitude)
    )
    return position, orientation

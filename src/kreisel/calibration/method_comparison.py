"""One recording calibrated by several estimators."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from kreisel.calibration.by_method import ByMethod
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.errors import KreiselError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.progress import Progress
from kreisel.recording.recording import Recording
from kreisel.tasks import Executor, sequential


def compare_methods(
    recording: Recording,
    methods: Sequence[str],
    progress: Progress | None = None,
    executor: Executor = sequential,
) -> tuple[ByMethod, ...]:
    """Return the calibrations of a recording by each of some estimators."""
    return tuple(_by_method(recording, name, progress, executor) for name in methods)


def _by_method(recording: Recording, name: str, progress: Progress | None, executor: Executor) -> ByMethod:
    settings, began = CalibrationSettings(estimator=name), time.perf_counter()
    try:
        outcome = run_calibration(recording, settings, progress, executor=executor, validate=True)
    except KreiselError as error:
        return ByMethod(name, None, str(error), time.perf_counter() - began)
    return ByMethod(name, outcome.calibration, None, time.perf_counter() - began, _drift(outcome))


def _drift(outcome: Outcome) -> tuple[float, float] | None:
    if outcome.cross is None:
        return None
    drift = outcome.cross.calibrated
    position, orientation = (
        float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
        for values in (drift.position, drift.attitude)
    )
    return position, orientation

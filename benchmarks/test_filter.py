"""The filter in strapdown passes over the same samples: ``pytest benchmarks --benchmark-only``.

Ratios within one run are what counts; machines differ and are noisy. `multiple` is in each test's extra info.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.navigation import SensorColumns, preintegrate

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.kalman.filter_pass import run_filter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import Problem
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

from . import yardstick

SECONDS = float(os.environ.get("KREISEL_BENCHMARK_SECONDS", "600"))
"""Length of the recording; short ones show that the benchmarks run."""


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(Cell.model_validate({"seed": 3, "seconds": SECONDS, "imu": {"rate": 400.0}}), Path("run"))[1]


@pytest.fixture(scope="module")
def unit(recording: Recording) -> float:
    return yardstick.seconds(recording.imu.rates, recording.imu.accelerations, recording.imu.interval)


def problem_of(recording: Recording, *, robot: bool) -> Problem:
    settings = CalibrationSettings()
    if not robot:
        recording = replace(recording, joints=None)
    return build_problem(prepare_recording(recording, settings), settings)


@pytest.mark.parametrize("width", [1, 8, 25, 67])
def test_columns_in_threads(benchmark: Any, recording: Recording, unit: float, width: int) -> None:
    """One pass over 240,000 samples with so many sets of gyro parameters side by side."""
    problem = problem_of(recording, robot=False)
    one = SensorColumns.single(problem.prior.start.sensors, SizeEffect.COMPLETED)
    columns = replace(one, rate=np.repeat(one.rate, width, axis=-1), force=np.repeat(one.force, width, axis=-1))

    def run() -> None:
        for update in problem.schedule.updates:
            signal, _ = problem.sensor.readings.holding(update.first, update.last)
            preintegrate(signal, update.first - signal.begin, update.last - signal.begin, columns)

    benchmark.pedantic(run, rounds=3)
    benchmark.extra_info["multiple"] = benchmark.stats.stats.median / unit


@pytest.mark.parametrize("robot", [False, True])
def test_filter(benchmark: Any, recording: Recording, unit: float, robot: bool) -> None:
    """One pass of the filter; with the robot's errors 42 states more."""
    problem = problem_of(recording, robot=robot)
    benchmark.pedantic(run_filter, args=(problem, problem.prior.start), rounds=3)
    benchmark.extra_info["states"] = problem.layout.degrees
    benchmark.extra_info["multiple"] = benchmark.stats.stats.median / unit


@pytest.mark.parametrize("name", ["ekf", "spkf", "batch"])
def test_estimators(benchmark: Any, recording: Recording, unit: float, name: str) -> None:
    """A fit from the start values with the robot's errors: one pass of a filter, all iterations of the batch."""
    problem = problem_of(recording, robot=True)
    benchmark.pedantic(ESTIMATORS[name].fit, args=(problem,), rounds=3, warmup_rounds=1)
    benchmark.extra_info["multiple"] = benchmark.stats.stats.min / unit


def test_preparation(benchmark: Any, recording: Recording) -> None:
    """Correlation, fits of rates and accelerometers, standstills."""
    benchmark.pedantic(prepare_recording, args=(recording, CalibrationSettings()), rounds=2)

"""The filter against one strapdown pass over the same samples: ``pytest benchmarks --benchmark-only``.

Ratios within one run are what counts; machines differ and are noisy.
"""

from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.filter_run import run_filter
from kreisel.calibration.settings import CalibrationSettings
from kreisel.calibration.setup import build_problem, prepare_recording
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.inertial.strapdown import SensorColumns, compile_kernels, preintegrate
from kreisel.simulation import simulate


@pytest.fixture(scope="module")
def problem():
    compile_kernels()
    _, recording = simulate(np.random.default_rng(3), 600.0, Path("ten minutes"), imu_rate=400.0)
    settings = CalibrationSettings()
    return build_problem(prepare_recording(recording, settings), settings)


def strapdown(problem, columns):
    for update in problem.updates:
        preintegrate(problem.signal, update.first, update.last, columns, SizeEffect.COMPLETED)


@pytest.mark.parametrize("width", [1, 8, 67])
def test_strapdown_passes(benchmark, problem, width):
    """One pass over 240,000 samples with so many parameter sets side by side."""
    one = SensorColumns.single(problem.start.sensors, SizeEffect.COMPLETED)
    parts = (one.K_omega, one.k_w, one.K_a, one.k_a, one.lever_arms, one.axes)
    columns = SensorColumns(*(np.repeat(part, width, axis=-1) for part in parts))
    benchmark.pedantic(strapdown, args=(problem, columns), rounds=3)


def test_filter(benchmark, problem):
    """One pass of the filter, 52 states."""
    benchmark.pedantic(run_filter, args=(problem, problem.start), rounds=3)


def test_preparation(benchmark):
    """Correlation, rate fit, force fit, rests."""
    _, recording = simulate(np.random.default_rng(3), 600.0, Path("ten minutes"), imu_rate=400.0)
    benchmark.pedantic(prepare_recording, args=(recording, CalibrationSettings()), rounds=2)

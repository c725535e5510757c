"""A fast cone in few samples: the gyros' biases are wrong by what sampling misses, and their deviations say so."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.units import DEG_PER_HOUR
from kreisel.validation.checks import check_streams

FREQUENCY, AMPLITUDE = 41.3, 0.3  # Hz, rad/s


def test_biases_of_exact_gyros_on_a_cone_are_within_their_deviations():
    cell = {"seed": 4, "seconds": 90.0, "imu": {"grade": "fog", "rate": 100.0}, "reference": {"kind": "mocap"}}
    truth, recording = simulate(Cell.model_validate(cell), Path("cell"))
    imu = recording.imu
    phase = 2.0 * np.pi * FREQUENCY * 1e-9 * (imu.stamps_ns - imu.stamps_ns[0])[:, None] + np.array([0.0, 1.2, 2.5])
    turned = AMPLITUDE / (2.0 * np.pi * FREQUENCY) * np.cos(phase)
    speed = -AMPLITUDE * np.sin(phase)
    shaken = replace(imu, rates=imu.rates + speed - 0.5 * np.cross(turned, speed))
    outcome = run_calibration(check_streams(replace(recording, imu=shaken)), CalibrationSettings())
    found = outcome.calibration
    error = np.abs(found.sensors.k_w[0] - truth.sensors.k_w[0])
    assert error.max() > 5.0 * DEG_PER_HOUR
    assert np.max(error / found.sensor_sd.k_w[0]) < 4.0
    assert any(one.cause == "vibration between samples" for one in outcome.estimate.contributions)
    assert any("coning" in str(warning) for warning in outcome.warnings)

"""Weak motion: nothing is outside the model, and results must be right although noise is as large as the motion."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.refinement import iteration
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.truth_comparison import group_errors
from kreisel.validation.checks import check_streams

pytestmark = pytest.mark.slow

CAMERAS = {
    "imu": {"grade": "consumer-mems"},
    "reference": {"kind": "mocap", "interval": 0.01},
    "errors": {"path_position_sd": 3e-4, "path_orientation_sd": 5e-4, "path_correlation_time": 0.0},
    "stated": {"place": False},
}


def calibrated(seed, motion):
    cell = Cell.model_validate({"seed": seed, "seconds": 150.0, **CAMERAS, "motion": motion})
    truth, recording = simulate(cell, Path("weak"))
    return truth, run_calibration(check_streams(recording), CalibrationSettings())


def largest(outcome, truth, group):
    error = group_errors(outcome.calibration, truth)[group]
    return float(np.abs(error.error / error.deviation).max())


def test_noise_does_not_pull_the_accelerometers_scale(monkeypatch):
    """A slow tool: what noise pulls is put back, and without that it is several deviations."""
    truth, outcome = calibrated(21, {"range_share": 0.01})
    assert outcome.verdict.accepted, outcome.verdict.reasons
    assert largest(outcome, truth, "accel_cross_coupling") < 4.5
    gravity = float(np.linalg.norm(truth.gravity_r))
    found = outcome.estimate
    sd = found.run.belief.standard_deviation[found.problem.layout["gravity"]][0]
    assert abs(found.run.parameters.gravity - gravity) < 3.5 * sd
    monkeypatch.setattr(iteration, "pull_of_noise", lambda *_: None)
    _, pulled = calibrated(21, {"range_share": 0.01})
    assert pulled.estimate.run.parameters.gravity < found.run.parameters.gravity - 0.015
    assert largest(pulled, truth, "accel_cross_coupling") > 1.5 * largest(outcome, truth, "accel_cross_coupling")


@pytest.mark.parametrize("seed", [22, 23])
def test_offsets_and_the_response_to_acceleration_are_told_apart_as_far_as_said(seed):
    truth, outcome = calibrated(seed, {"range_share": 0.05})
    assert outcome.verdict.accepted, outcome.verdict.reasons
    included = {effect.group for effect in outcome.estimate.considered if effect.included}
    assert included == {"gyro_g_sensitivity"}  # and no smoothing, which noise imitates
    for group in ("gyro_offset", "gyro_cross_coupling", "accel_offset", "lever_arms"):
        assert largest(outcome, truth, group) < 4.5

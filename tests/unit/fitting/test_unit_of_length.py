"""The unit of length of positions that no data show: noise must not show it either."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.linear_errors import LINEAR_ERRORS
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.validation.checks import check_streams

PRIOR_BY_GRAVITY = 0.015 / 9.80665
"""How well the unit of length is known by gravity where nothing is stated about the place."""


def cameras_without_a_place(seconds, settings=None, **reference):
    cell = Cell.model_validate({
        "seed": 6, "seconds": seconds, "imu": {"grade": "fog"},
        "reference": {"kind": "mocap", "interval": 0.01, **reference},
        "errors": {"path_position_sd": 3e-4, "path_orientation_sd": 5e-4, "path_correlation_time": 0.0},
    })  # fmt: skip
    _, recording = simulate(cell, Path("cell"))
    stated = RecordingSettings.model_validate({"reference": {"kind": "mocap"}, "imu": {"grade": "fog"}})
    return run_calibration(check_streams(replace(recording, settings=stated)), settings or CalibrationSettings())


def scales_by(outcome, cause):
    d = outcome.problem.layout["accel_cross_coupling"]
    [found] = [one for one in outcome.estimate.contributions if one.cause == cause]
    return np.sqrt(found.variance[d][::4])


def test_exact_cameras_show_no_scale_by_their_noise():
    outcome = cameras_without_a_place(150.0)
    assert outcome.verdict.accepted
    assert "position_scale" not in outcome.problem.layout
    assert scales_by(outcome, f"{LINEAR_ERRORS} that show").max() < 2e-4
    # a scale of 0.1 % beside what gravity says of it
    want = 1e-3 / np.hypot(1.0, 1e-3 / PRIOR_BY_GRAVITY)
    np.testing.assert_allclose(scales_by(outcome, LINEAR_ERRORS), want, rtol=0.02)


@pytest.mark.parametrize("ppm", [0.0, 20_000.0])
def test_the_scale_of_positions_is_what_gravity_says(ppm):
    """Its mean is that of two priors: of the scale, and of gravity over the gravity that fits the positions."""
    settings = CalibrationSettings(estimated=["position_scale"])
    outcome = cameras_without_a_place(100.0, settings, position_scale_ppm=ppm)
    layout, run = outcome.problem.layout, outcome.estimate.run
    found = float(run.parameters.stored("position_scale")[0])
    sd = float(run.belief.standard_deviation[layout["position_scale"].start])
    apparent = run.parameters.gravity * (1.0 + found)  # of the positions' unit
    of_scale = float(np.sqrt(outcome.problem.prior.covariance["position_scale"][0, 0]))
    by_gravity = apparent / 9.80665 - 1.0
    want = by_gravity / (1.0 + (PRIOR_BY_GRAVITY / of_scale) ** 2)
    assert abs(found - want) < 0.1 * sd


@pytest.mark.slow
def test_forty_minutes_of_exact_cameras_are_accepted():
    outcome = cameras_without_a_place(2400.0)
    assert outcome.verdict.accepted
    assert "position_scale" not in outcome.problem.layout
    assert scales_by(outcome, f"{LINEAR_ERRORS} that show").max() < 2e-4

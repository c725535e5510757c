"""Calibration by standstills at poses: the truth is found, derivatives, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import exp, matrix
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.static.by_robot import METHOD, calibrate_by_robot
from kreisel.static.pose_attitudes import PoseAttitudes
from kreisel.static.rest_chain import ATTITUDE
from kreisel.validation.checks import check_streams

LINEAR = 27
"""Sums of the entries of the attitude in three components."""


def cell(**reference):
    content = {"seed": 8, "seconds": 100.0, "reference": reference, "imu": {"grade": "fog-mems"}}
    truth, recording = simulate(Cell.model_validate(content), Path("cell"))
    return truth, check_streams(recording)


@pytest.fixture(scope="module", params=[True, False], ids=["joints", "poses alone"])
def calibrated(request):
    truth, recording = cell(joints=request.param)
    return truth, calibrate_by_robot(recording, CalibrationSettings())


def test_the_truth_is_found(calibrated):
    truth, outcome = calibrated
    calibration = outcome.calibration
    assert calibration.accepted
    assert calibration.axes == "tool"
    assert calibration.estimator.name == outcome.method == METHOD
    problem = outcome.found.problem
    layout, sd = problem.layout, np.sqrt(np.diag(calibration.covariance))
    p = outcome.found.parameters.sensors
    for group, found, true in (
        ("gyro_cross_coupling", p.K_omega, truth.sensors.K_omega),
        ("gyro_offset", p.k_w[0], truth.sensors.k_w[0]),
        ("accel_cross_coupling", p.K_a, truth.sensors.K_a),
        ("accel_offset", p.k_a[0], truth.sensors.k_a[0]),
    ):
        score = (found - true).ravel() / sd[layout[group]]
        assert np.abs(score).max() < 4.0
        assert np.sqrt(np.mean(score**2)) < 1.8
    gravity = calibration.alignment.gravity
    assert (np.abs(gravity.value - truth.gravity_r) < 4.0 * gravity.deviation).all()
    assert (gravity.deviation[:2] < 0.01).all()


def test_errors_of_the_arm_are_estimated_where_joints_are_recorded(calibrated):
    _, outcome = calibrated
    (known,) = outcome.found.problem.known
    assert isinstance(known, PoseAttitudes)
    names = outcome.found.problem.names
    warned = any(warning.subject == "robot" for warning in outcome.warnings)
    assert warned == (known.width.size == LINEAR)  # deviations contain the tool's attitude, and that is said
    assert any(name.startswith("robot.error") for name in names)
    assert outcome.calibration.names == names[: outcome.found.problem.reported]
    # what the arm errs by counts as noise of each pose, or as errors of the arm and less noise
    assert (outcome.found.noise.known[0] < 2.5e-4) != warned


def test_derivatives_are_those_of_differences(calibrated):
    _, outcome = calibrated
    problem = outcome.found.problem
    (known,) = problem.known
    rng = np.random.default_rng(2)
    change = np.zeros(problem.layout.degrees)
    change[problem.reported :] = 1e-3 * rng.normal(size=change.size - problem.reported)
    p = problem.changed(outcome.found.parameters, change)
    C = known.attitudes(p) @ matrix(exp(2e-3 * rng.normal(size=(known.node.size, 3))))
    one = known.equations(problem, p, C)
    for i in range(problem.reported, problem.layout.degrees):
        step = np.zeros(problem.layout.degrees)
        step[i] = 1e-4
        after, before = (known.equations(problem, problem.changed(p, s * step), C).residual for s in (1.0, -1.0))
        found = (after - before) / 2e-4
        np.testing.assert_allclose(one.of_parameters[:, :, i], found, atol=5e-3 * np.abs(found).max())
    for k in range(3):
        moved = C @ matrix(exp(1e-6 * np.eye(3)[k]))
        found = (known.equations(problem, p, moved).residual - one.residual) / 1e-6
        np.testing.assert_allclose(found, one.of_node[:, :, ATTITUDE][:, :, k], atol=5e-3)


def test_what_it_cannot_do_is_said():
    _, recording = cell(joints=False, measures="position")
    with pytest.raises(RecordingError, match="positions alone"):
        calibrate_by_robot(recording, CalibrationSettings())
    _, recording = cell(joints=False)
    few = recording.reference.part(recording.reference.seconds < 22.0)
    with pytest.raises(RecordingError, match="standstills with poses, expected 6"):
        calibrate_by_robot(replace(recording, reference=few), CalibrationSettings())

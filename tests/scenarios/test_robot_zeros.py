"""Arms whose joints' zeros are off by degrees: found with recorded joint angles, and from poses alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.errors import RobotError
from kreisel.geometry.rotation import conjugate, exp, log, multiply
from kreisel.kalman.kernel_inputs import filter_steps
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording_settings import RobotTable
from kreisel.robot import kinematics
from kreisel.robot.description import parse_arm
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.truth_comparison import group_errors

EXACT_POSES = {
    "path_position_sd": 0.0, "path_orientation_sd": 0.0, "repeatability_position_sd": 0.0,
    "repeatability_orientation_sd": 0.0, "geometry_length_sd": 1e-4, "geometry_angle_sd": 1e-4,
}  # fmt: skip
"""A controller's poses are those of its nominal kinematics."""


def recorded(zero_sd, robot=None):
    cell = Cell.model_validate({"seed": 6, "seconds": 150.0, "errors": {**EXACT_POSES, "zero_sd": zero_sd}})
    truth, recording = simulate(cell, Path("cell"))
    table = RobotTable() if robot is None else robot
    settings = recording.settings.model_copy(update={"robot": table})
    return truth, replace(recording, settings=settings)


@pytest.fixture(scope="module")
def off():
    return recorded(0.03)


@pytest.fixture(scope="module")
def by_angles(off):
    return run_calibration(off[1], CalibrationSettings())


@pytest.fixture(scope="module")
def by_poses(off):
    return run_calibration(replace(off[1], joints=None), CalibrationSettings())


@pytest.mark.parametrize("which", ["by_angles", pytest.param("by_poses", marks=pytest.mark.slow)])
def test_zeros_are_found(which, off, request):
    outcome = request.getfixturevalue(which)
    assert outcome.verdict.accepted, outcome.verdict.reasons
    found = outcome.calibration.document["robot"]
    off_by = np.array(found["zeros"]) - off[0].arm.zeros
    assert np.abs(off_by / found["zeros_standard_deviation"]).max() < 4.0
    assert np.abs(off_by).max() < 0.02 * np.abs(off[0].arm.zeros).max()
    assert outcome.verdict.causes[0].name == "robot_zeros"
    for group in group_errors(outcome.calibration, off[0]).values():
        assert group.ratio < 2.5, group.title


def test_the_description_has_them(by_angles, off):
    """Poses by the calibrated description are those of the tool, up to base and tool frame: motions between poses."""
    arm = by_angles.problem.robot.arm
    angles = by_angles.problem.robot.angles[::500]
    true = kinematics.with_placement_errors(arm, off[0].arm.placement)
    moved = angles.copy()
    moved[:, 1:-1] += off[0].arm.zeros
    p, _ = kinematics.poses(true, moved)
    again, _ = kinematics.poses(parse_arm(by_angles.calibration.robot_urdf, arm.tcp), angles)
    nominal, _ = kinematics.poses(arm, angles)
    assert np.abs(again - p).max() < 0.05 * np.abs(nominal - p).max()


@pytest.mark.slow
def test_a_faultless_arm_has_none():
    _, recording = recorded(0.0)
    outcome = run_calibration(replace(recording, joints=None), CalibrationSettings())
    assert outcome.verdict.accepted
    assert "robot_zeros" not in outcome.problem.layout
    assert outcome.problem.joints == 6


def test_a_pass_is_linear_about_its_zeros(by_angles):
    """Reported poses, moved by the regressor, are those of the arm with these zeros, not only to first order."""
    problem = by_angles.problem
    zeros = np.array([0.05, -0.04, 0.06, -0.05])
    known = problem.prior.start
    known = replace(known, robot=replace(known.robot, zeros=zeros))
    updates = problem.schedule.updates[:40]
    poses = np.array([update.pose for update in updates])
    steps = filter_steps(problem, known, updates, np.zeros((40, 6, 0)))
    linear = steps.regressor[:, :, known.robot.part("robot_zeros")] @ zeros
    arm, angles = problem.robot.arm, problem.robot.angles[poses]
    moved = angles.copy()
    moved[:, 1:-1] += zeros
    (p, q), (p0, q0) = kinematics.poses(arm, moved), kinematics.poses(arm, angles)
    reference = problem.reference
    np.testing.assert_allclose(steps.position + linear[:, :3], reference.positions[poses] + p - p0, atol=1e-12)
    turned = multiply(reference.quaternions[poses], multiply(conjugate(q0), q))
    np.testing.assert_allclose(
        log(multiply(conjugate(turned), multiply(steps.quaternion, exp(linear[:, 3:])))), 0.0, atol=1e-12
    )


@pytest.mark.slow
def test_the_arm_must_be_known(off):
    for model, message in (
        ("irb2500", r"unknown robot.model 'irb2500'; known are: .*irb2400"),
        ("irb120", "state its tool"),
    ):
        stated = off[1].settings.model_copy(update={"robot": RobotTable(model=model)})
        with pytest.raises(RobotError, match=message):
            run_calibration(replace(off[1], joints=None, urdf=None, settings=stated), CalibrationSettings())


@pytest.mark.slow
def test_another_arm_is_no_arm(off):
    """A description that does not reach the poses: a warning, and errors as of any robot."""
    urdf = kinematics.load_arm("irb120").urdf
    outcome = run_calibration(replace(off[1], joints=None, urdf=urdf), CalibrationSettings(passes=1))
    assert outcome.problem.robot is None
    assert any(
        "joint angles cannot be computed from the poses: irb120 does not reach" in str(w) for w in outcome.warnings
    )

"""The robot's errors: estimated honestly, found where they show, and put into its description."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.errors import RobotError, SettingsError
from kreisel.geometry.rotation import conjugate, exp, log, multiply
from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import RobotParameters
from kreisel.model.robot_model import pose_regressor
from kreisel.recording.recording_settings import RobotTable
from kreisel.robot import kinematics
from kreisel.robot.description import parse_arm
from kreisel.robot.kinematics import load_arm, with_placement_errors
from kreisel.robot.urdf import calibrated_urdf
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.truth_comparison import group_errors


@pytest.fixture(scope="module")
def inaccurate():
    """A cell with errors in every placement, its truth, and its calibration."""
    cell = Cell.model_validate({"seed": 5, "seconds": 200.0})
    truth, recording = simulate(cell, Path("cell"))
    return truth, recording, run_calibration(recording, CalibrationSettings())


def test_every_group_is_honest(inaccurate):
    """Error over standard deviation; the rms of two to nine correlated scores stays below 2.2 with 99 %."""
    truth, _, outcome = inaccurate
    assert outcome.verdict.accepted
    for group in group_errors(outcome.calibration, truth).values():
        assert group.ratio < 2.2, group.title


def test_an_arm_that_an_unknown_effect_hides_at_first_shows_once_the_effect_is_known():
    """Gyros that respond to acceleration make all noise larger: a fifth of the arm's usual errors seemed likeliest."""
    content = {
        "seed": 1, "seconds": 150.0, "imu": {"grade": "consumer-mems"}, "reference": {"joints": False},
        "stated": {"robot": False}, "errors": {"geometry_length_sd": 1e-3, "geometry_angle_sd": 1e-3},
        "unlisted": {"gyro": 1},
    }  # fmt: skip
    _, recording = simulate(Cell.model_validate(content), Path("cell"))
    outcome = run_calibration(recording, CalibrationSettings())
    usual = outcome.estimate.stated.noise.frame_sd
    assert np.divide(outcome.problem.noise.frame_sd, usual) == pytest.approx(1.5, abs=0.3)
    assert "as large as the poses show" in next(w.message for w in outcome.warnings if w.subject == "robot")


def test_taken_for_noise_they_are_not(inaccurate):
    truth, recording, _ = inaccurate
    settings = recording.settings.model_copy(update={"robot": RobotTable(length_sd=0.0, angle_sd=0.0)})
    recording = replace(recording, settings=settings)
    outcome = run_calibration(recording, CalibrationSettings(fixed=("robot_placement",)))
    assert outcome.problem.robot is None
    errors = group_errors(outcome.calibration, truth)
    assert errors["accel_cross_coupling"].ratio > 2.5


def test_poses_not_used_are_better_after(inaccurate):
    """Poses all over the ranges, base and tool frame fitted away: those no IMU sees."""
    truth, _, outcome = inaccurate
    nominal = outcome.problem.robot.arm
    found = outcome.estimate.run.parameters.robot.placement
    rng = np.random.default_rng(0)
    angles = rng.uniform(0.8 * np.maximum(nominal.lower, -np.pi), 0.8 * np.minimum(nominal.upper, np.pi), (200, 6))
    J = kinematics.derivatives(nominal, angles).regressor.reshape(-1, 42)
    frames = np.hstack([J[:, :6], J[:, -6:]])

    def left(arm):
        p, q = kinematics.poses(arm, angles)
        p0, q0 = kinematics.poses(truth.actual, angles)
        error = np.hstack([p0 - p, log(multiply(conjugate(q), q0))]).ravel()
        error -= frames @ np.linalg.lstsq(frames, error, rcond=None)[0]
        error = error.reshape(-1, 6)
        return [np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (error[:, :3], error[:, 3:])]

    before, after = left(nominal), left(with_placement_errors(nominal, found))
    assert after[0] < 0.7 * before[0]
    assert after[1] < 0.3 * before[1]
    believed = outcome.calibration.document["robot"]["pose_error"]["believed_after"]
    assert after[0] < 2.5 * believed["position_rms"]


def test_the_calibrated_description_reads_back(inaccurate):
    _, _, outcome = inaccurate
    nominal, found = outcome.problem.robot.arm, outcome.estimate.run.parameters.robot.placement
    again = parse_arm(outcome.calibration.robot_urdf, nominal.tcp)
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 6))
    for a, b in zip(
        kinematics.poses(again, angles), kinematics.poses(with_placement_errors(nominal, found), angles), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-10)


def test_a_tool_without_a_fixed_joint_gets_one():
    arm = load_arm("ur10e", "link_6")
    errors = np.zeros((7, 6))
    errors[-1] = [1e-3, 2e-3, -1e-3, 1e-3, 0.0, 2e-3]
    text = calibrated_urdf(arm, errors)
    angles = np.full((1, 6), 0.3)
    p, q = kinematics.poses(parse_arm(text, "link_6_calibrated"), angles)
    p0, q0 = kinematics.poses(with_placement_errors(arm, errors), angles)
    np.testing.assert_allclose(p, p0, atol=1e-10)
    np.testing.assert_allclose(log(multiply(conjugate(q), q0)), 0.0, atol=1e-10)


def test_regressor_of_gears_sag_and_zeros_by_differences():
    arm = load_arm("kr125")
    rng = np.random.default_rng(3)
    angles = rng.uniform(0.5 * np.maximum(arm.lower, -2), 0.5 * np.minimum(arm.upper, 2), (5, 6))
    errors = RobotParameters(
        np.zeros((7, 6)), 1e-6 * rng.normal(size=(6, 2)), 1e-10 * rng.normal(size=6), 1e-6 * rng.normal(size=4)
    )
    torque = kinematics.gravity_torques(arm, angles)
    moved = angles + errors.gears[:, 0] * np.sin(angles) + errors.gears[:, 1] * np.cos(angles)
    moved = moved - errors.compliance * torque
    moved[:, 1:-1] += errors.zeros
    p, q = kinematics.poses(arm, angles)
    p1, q1 = kinematics.poses(arm, moved)
    change = pose_regressor(arm, angles) @ errors.vector
    np.testing.assert_allclose(p1 - p, change[:, :3], atol=1e-10)
    np.testing.assert_allclose(log(multiply(conjugate(q), q1)), change[:, 3:], atol=1e-10)


def test_gears_and_sag_are_found_if_asked_for():
    cell = Cell.model_validate({
        "seed": 8, "seconds": 200.0,
        "errors": {"geometry_length_sd": 1e-5, "geometry_angle_sd": 1e-5, "gear_eccentricity_sd": 3e-4, "sag_sd": 5e-4},
    })  # fmt: skip
    truth, recording = simulate(cell, Path("cell"))
    settings = CalibrationSettings(estimated=("robot_gears", "robot_compliance"))
    outcome = run_calibration(recording, settings)
    table = outcome.calibration.document["robot"]
    own = truth.arm
    true = np.column_stack([own.eccentricity * np.cos(own.phase), own.eccentricity * np.sin(own.phase)])
    score = (np.array(table["gears"]) - true) / np.array(table["gears_standard_deviation"])
    assert np.sqrt(np.mean(score**2)) < 2.0
    narrowed = np.array(table["gears_standard_deviation"]) < 0.5 * 2e-4
    assert narrowed.sum() >= 4  # the wrist's and the second joint's show; not all are told from placements
    for group in group_errors(outcome.calibration, truth).values():
        assert group.ratio < 2.5, group.title


def test_another_tool_frame_is_said_not_hidden(inaccurate):
    _, recording, _ = inaccurate
    poses = recording.reference
    shifted = replace(poses, quaternions=multiply(poses.quaternions, exp(np.array([0.0, 0.0, 0.5]))))
    outcome = run_calibration(replace(recording, reference=shifted), CalibrationSettings())
    assert outcome.problem.robot is None
    assert any("tool frame" in str(warning) for warning in outcome.warnings)


def test_joints_that_do_not_fit_the_description_are_refused(inaccurate):
    _, recording, _ = inaccurate
    joints = replace(recording.joints, angles=recording.joints.angles[:, :5])
    with pytest.raises(RobotError, match="5 joint angles, but 6 joints"):
        run_calibration(replace(recording, joints=joints), CalibrationSettings())


def test_groups_by_choice_are_named():
    with pytest.raises(SettingsError, match="robot_gears"):
        CalibrationSettings(estimated=("robot_gear",))


def test_lasting_errors_are_found_and_honest():
    """Motion capture whose errors last a second: their length within a factor of three, deviations honest."""
    cell = Cell.model_validate({
        "seed": 4, "seconds": 200.0, "reference": {"kind": "mocap", "interval": 0.01},
        "errors": {
            "geometry_length_sd": 0.0, "geometry_angle_sd": 0.0, "repeatability_position_sd": 0.0,
            "repeatability_orientation_sd": 0.0, "path_correlation_time": 1.0,
        },
    })  # fmt: skip
    truth, recording = simulate(cell, Path("cell"))
    outcome = run_calibration(recording, CalibrationSettings())
    assert outcome.problem.noise.correlation_time == pytest.approx(1.0, rel=2.0)
    assert outcome.problem.noise.correlation_time > 1.0 / 3.0
    for group in group_errors(outcome.calibration, truth).values():
        assert group.ratio < 2.2, group.title


def test_stated_errors_without_joint_angles_are_not_forgotten(inaccurate):
    """Base and tool may lie elsewhere by what the owner says: K, lever arms and gravity stay honest."""
    truth, recording, _ = inaccurate
    outcome = run_calibration(replace(recording, joints=None, urdf=None), CalibrationSettings())
    assert any("cannot be estimated" in str(warning) for warning in outcome.warnings)
    errors = group_errors(outcome.calibration, truth)
    for name in ("gyro_cross_coupling", "accel_cross_coupling", "lever_arms", "alignment"):
        assert errors[name].ratio < 2.2, name


def test_without_a_latitude_the_earths_rotation_is_found():
    cell = Cell.model_validate({"seed": 6, "seconds": 100.0, "imu": {"grade": "ring-laser"}})
    truth, recording = simulate(cell, Path("cell"))
    settings = recording.settings.model_copy(update={"site": type(recording.settings.site)(gravity=9.81)})
    outcome = run_calibration(replace(recording, settings=settings), CalibrationSettings())
    errors = group_errors(outcome.calibration, truth)
    for name in ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling"):
        assert errors[name].ratio < 2.2, name
    assert errors["gyro_offset"].expected < 1.0  # deg/h
    alignment = outcome.calibration.document["alignment"]
    sd = outcome.calibration.document["standard_deviation"]["alignment"]["earth_rate"]
    off = np.array(alignment["earth_rate"]) - truth.earth_rate_r
    assert np.abs(off / sd).max() < 4.0
    assert np.linalg.norm(alignment["earth_rate"]) == pytest.approx(EARTH_RATE, rel=0.05)
    assert any("latitude" in str(warning) for warning in outcome.warnings)


@pytest.mark.parametrize("measures", ["position", "orientation"])
def test_half_a_pose_is_honest_about_what_it_shows(measures):
    cell = Cell.model_validate({
        "seed": 31, "seconds": 150.0, "reference": {"measures": measures, "kind": "mocap"},
        "errors": {"geometry_length_sd": 0.0, "geometry_angle_sd": 0.0},
    })  # fmt: skip
    truth, recording = simulate(cell, Path("cell"))
    outcome = run_calibration(recording, CalibrationSettings())
    assert outcome.verdict.accepted
    errors = group_errors(outcome.calibration, truth)
    for name in ("gyro_offset", "accel_offset"):  # what does not hang on how b lies
        assert errors[name].ratio < 2.2, name

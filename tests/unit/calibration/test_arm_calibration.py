"""The robot by the IMU: errors against truth, poses not used, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from kreisel.calibration.arm_calibration import _without_negative, arm_of, arm_of_all
from kreisel.calibration.arm_result import BEYOND_URDF, NOT_SHOWN, ArmError
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.joint import calibrate_joint
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import conjugate, log, multiply
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.report.arm_page import write_arm
from kreisel.robot import kinematics
from kreisel.robot.kinematics import load_arm
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

LARGE = 1e-3


def cell(run, **more):
    """Return the truth and a recording, `run` choosing another motion of the same arm and device."""
    content = {
        "seed": 5, "run": run, "seconds": 90.0, "imu": {"grade": "fog-mems"},
        "errors": {"geometry_length_sd": LARGE, "geometry_angle_sd": LARGE}, **more,
    }  # fmt: skip
    return simulate(Cell.model_validate(content), Path(f"run{run}"))


@pytest.fixture(scope="module")
def one():
    truth, recording = cell(0)
    return truth, recording, arm_of(run_calibration(recording, CalibrationSettings()))


def left(nominal, actual, errors, angles):
    """Return rms position and angle by which an arm with errors misses the actual one, without base and tool frames."""
    corrected = kinematics.with_placement_errors(nominal, errors)
    (p, q), (p_true, q_true) = (kinematics.poses(arm, angles) for arm in (corrected, actual))
    away = np.hstack([p_true - p, log(multiply(conjugate(q), q_true))]).ravel()
    J = kinematics.derivatives(nominal, angles).regressor
    frames = np.concatenate([J[:, :, :6], J[:, :, -6:]], axis=2).reshape(-1, 12)
    away = (away - frames @ np.linalg.lstsq(frames, away, rcond=None)[0]).reshape(-1, 6)
    return [float(np.sqrt(np.mean(np.sum(part**2, axis=1)))) for part in (away[:, :3], away[:, 3:])]


def test_the_errors_are_those_of_the_arm(one):
    truth, _, found = one
    assert found.calibration.accepted
    scores = []
    true = dict(zip(placement_names(truth), truth.arm.placement.ravel(), strict=True))
    for error in found.errors:
        if error.name.startswith("robot.placement"):
            scores.append((error.value - true[error.name]) / error.deviation)
            assert error.unit in ("mm", "mrad")
    scores = np.array(scores)
    assert np.abs(scores).max() < 4.0
    assert np.sqrt(np.mean(scores**2)) < 1.3
    shown = [error for error in found.errors if error.separable]
    assert 10 < len(shown) < len(found.errors)
    assert min(error.deviation / error.prior for error in shown) < 0.15


def placement_names(truth):
    return [f"robot.placement[{j},{i}]" for j in range(len(truth.arm.placement)) for i in range(6)]


def described(folder, recording):
    """Return the arm of a recording's description."""
    (folder / "nominal.urdf").write_text(recording.urdf)
    return load_arm(folder / "nominal.urdf", recording.settings.robot.tcp)


def test_poses_that_were_not_used_are_better(one, tmp_path):
    """By truth at joint angles of another motion, and by what the result itself says of its halves."""
    truth, recording, found = one
    nominal = described(tmp_path, recording)
    angles = cell(1)[1].joints.angles[::400]
    none, estimate = np.zeros_like(truth.arm.placement), found.robot.placement.value
    before, after = left(nominal, truth.actual, none, angles), left(nominal, truth.actual, estimate, angles)
    assert after[0] < 0.6 * before[0]
    assert after[1] < 0.3 * before[1]
    assert [part.name for part in found.unused] == ["first half", "second half"]
    for part in found.unused:
        assert part.after.orientation < 0.5 * part.before.orientation
        for kind in ("position", "orientation"):
            assert 0.4 < getattr(part.after, kind) / getattr(part.expected, kind) < 1.8


def test_several_recordings_judge_each_other(one):
    _, first, _ = one
    found = arm_of_all(calibrate_joint([first, cell(1)[1]], names=["a", "b"]))
    assert [(part.name, part.used) for part in found.unused] == [("a", "b"), ("b", "a")]
    for part in found.unused:
        assert part.after.orientation < 0.4 * part.before.orientation
        assert 0.3 < part.after.orientation / part.expected.orientation < 2.0


def test_the_result_is_written(one, tmp_path):
    _, recording, found = one
    found.write(tmp_path)
    write_arm(found, tmp_path / "report.html")
    document = YAML(typ="safe").load(tmp_path / "robot.yaml")
    assert document["joints"] == list(found.robot.joints)
    assert len(document["errors"]) == len(found.errors)
    assert document["not_shown"] == list(NOT_SHOWN)
    assert len(document["unused_poses"]) == 2
    corrected = load_arm(tmp_path / "robot.urdf", recording.settings.robot.tcp)
    nominal = described(tmp_path, recording)
    angles = recording.joints.angles[::1000]
    expected = kinematics.poses(kinematics.with_placement_errors(nominal, found.robot.placement.value), angles)[0]
    np.testing.assert_allclose(kinematics.poses(corrected, angles)[0], expected, atol=1e-8)
    assert "not used" in (tmp_path / "report.html").read_text()


def test_without_an_arm_it_says_what_is_missing():
    _, recording = cell(0, reference={"joints": False})
    with pytest.raises(RecordingError, match="joint angles and its description"):
        arm_of(run_calibration(recording, CalibrationSettings()))


def test_why_an_arm_with_joint_angles_cannot_be_calibrated_is_said():
    _, recording = cell(0)
    joints = recording.joints
    wrong = replace(joints, angles=joints.angles[:, [1, 0, *range(2, joints.angles.shape[1])]])
    with pytest.raises(RecordingError, match=r"cannot be calibrated: reported poses differ by .* order or signs"):
        arm_of(run_calibration(replace(recording, joints=wrong), CalibrationSettings()))


def test_what_robot_urdf_alone_leaves_is_said():
    """Sag of 2 mrad: a robot description holds no compliance."""
    errors = {"geometry_length_sd": 3e-4, "geometry_angle_sd": 3e-4, "sag_sd": 2e-3}
    _, recording = cell(0, errors=errors)
    found = arm_of(run_calibration(recording, CalibrationSettings()))
    assert found.calibration.accepted
    assert BEYOND_URDF in [warning.message for warning in found.warnings]
    for part in found.unused:
        assert part.by_urdf.orientation > 2.0 * part.after.orientation
        assert part.expected.position < 3.0 * part.after.position


@pytest.mark.parametrize(("value", "accepted"), [(-3e-7, False), (-5e-8, True), (3e-7, True)])
def test_a_joint_that_yields_against_its_load_is_a_reason_against_the_result(one, value, accepted):
    errors = [ArmError("robot.compliance[1]", "j2: compliance", "µrad/(N m)", 1e-6, value, 2e-8, 1e-6)]
    verdict = _without_negative(one[2].calibration.verdict, errors)
    assert verdict.accepted == accepted
    assert accepted or "compliance of j2 is negative" in verdict.reasons[-1]

"""Joint angles of a robot, as they come in recordings, made into a model of its errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.preparation.robot_errors import robot_model
from kreisel.recording.header import HeaderUnits
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.robot import kinematics
from kreisel.robot.excitation import home
from kreisel.units import DEG

FILE = Path("run/joint0/data.csv")


def recorded(unit: float = 1.0, stated: str | None = None) -> Recording:
    """Return a recording of an arm that moves by few degrees about zero, its angles in some unit."""
    arm = kinematics.load_arm("ur10e")
    stamps = np.arange(200) * 10_000_000
    angles = 0.1 * np.sin(1e-9 * stamps[:, None] * np.arange(1.0, 7.0)) + np.where(home(arm) > 0.0, 0.02, -0.02)
    p, q = kinematics.poses(arm, angles)
    imu = ImuSamples(stamps, np.zeros((200, 3)), np.zeros((200, 3)), Path("run/imu0/data.csv"))
    reference = ReferencePoses("pose0", stamps, p, q, Path("run/pose0/data.csv"))
    joints = JointAngles(stamps, angles / unit, FILE, HeaderUnits(angle=stated))
    return Recording(Path("run"), imu, reference, joints, urdf=arm.urdf)


def model_of(r: Recording):
    return robot_model(r.settings.robot, r.urdf, r.joints, r.reference, arm=True)


def test_small_angles_in_degrees_are_converted_where_the_poses_prove_it() -> None:
    right, degrees = recorded(), recorded(DEG)
    want, said = model_of(right)
    assert said == []
    got, (warning,) = model_of(degrees)
    np.testing.assert_allclose(got.angles, want.angles, rtol=1e-14)
    assert "joint angles are in degrees, as the poses show, and were converted" in warning.message
    assert "write q_1 [deg] into the header" in warning.message


def test_small_angles_in_degrees_under_radians_are_refused() -> None:
    degrees = recorded(DEG, "rad")
    with pytest.raises(RecordingError, match=r"line 1: .* look like degrees; the header says \[rad\]: correct it"):
        model_of(degrees)


def test_another_frame_is_no_other_unit() -> None:
    r = recorded()
    model, (warning,) = model_of(replace(r, reference=replace(r.reference, positions=r.reference.positions + 0.1)))
    assert model is None
    assert "base or tool frame differ" in warning.message

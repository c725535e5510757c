"""Arms that recording.toml names: joint angles by the stated tool, and what is said of a tool without an arm."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.preparation.arm_of_poses import arm_of_poses
from kreisel.recording.recording import ImuSamples, Recording, ReferencePoses
from kreisel.recording.recording_settings import read_settings
from kreisel.robot import kinematics
from kreisel.robot.arm_library import LIBRARY, Tool
from kreisel.robot.description import parse_arm

TOOL = Tool((0.05, -0.02, 0.2), (0.8, 0.0, 0.6, 0.0))


def recorded(text: str, folder: Path) -> tuple[np.ndarray, Recording]:
    """Return joint angles of an IRB 2400 with a bent tool, and a recording of its poses with settings."""
    arm = parse_arm(LIBRARY["irb2400"].urdf(TOOL), "tool0", "irb2400")
    stamps = np.arange(200) * 10_000_000
    angles = 0.3 * np.sin(1e-9 * stamps[:, None] * np.arange(1.0, 7.0)) + np.array([0.1, 0.1, 0.1, 0.0, 0.6, 0.1])
    p, q = kinematics.poses(arm, angles)
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    imu = ImuSamples(stamps, np.zeros((200, 3)), np.zeros((200, 3)), Path("run/imu0/data.csv"))
    reference = ReferencePoses("pose0", stamps, p, q, Path("run/pose0/data.csv"))
    return angles, replace(Recording(Path("run"), imu, reference), settings=read_settings(folder / "recording.toml"))


def test_a_stated_arm_and_tool_give_joint_angles(tmp_path: Path) -> None:
    text = (
        '[reference]\nkind = "robot"\n[robot]\nmodel = "irb2400"\n'
        "tool_position = [0.05, -0.02, 0.2]\ntool_quaternion = [0.8, 0.0, 0.6, 0.0]\n"
    )
    angles, recording = recorded(text, tmp_path)
    arm, found, warnings = arm_of_poses(recording.settings.robot, recording.urdf, recording.reference, arm=True)
    assert arm is not None
    assert arm.name == "irb2400"
    assert warnings == []
    np.testing.assert_allclose(found, angles, atol=1e-6)


def test_a_tool_without_an_arm_is_said_not_to_be_used(tmp_path: Path) -> None:
    _, recording = recorded('[reference]\nkind = "robot"\n[robot]\ntool_position = [0, 0, 0.2]\n', tmp_path)
    arm, _, warnings = arm_of_poses(recording.settings.robot, recording.urdf, recording.reference, arm=True)
    assert arm is None
    (warning,) = warnings
    assert "robot.tool_position in recording.toml is not used" in warning.message

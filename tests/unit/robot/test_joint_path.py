"""Joint angles from poses: those the poses were computed from, also through singular postures, or an error."""

import itertools

import numpy as np
import pytest

from kreisel.errors import RobotError
from kreisel.geometry.rotation import conjugate, exp, log, multiply
from kreisel.robot import kinematics
from kreisel.robot.arm_library import LIBRARY
from kreisel.robot.description import parse_arm
from kreisel.robot.joint_path import joint_path
from kreisel.robot.kinematics import load_arm


def moves(targets, samples=60):
    """Joint angles along smooth moves between targets (k, n)."""
    s = np.linspace(0.0, 1.0, samples)[:, None]
    s = 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5
    return np.vstack([a + (b - a) * s for a, b in itertools.pairwise(targets)])


def drawn(arm, seed, count=5):
    low, high = 0.8 * np.maximum(arm.lower, -2.0), 0.8 * np.minimum(arm.upper, 2.0)
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", ["kr125", "ur10e", "irb2400", "kr6r900", "m10ia"])
def test_the_angles_come_back(name):
    """Poses are those of the angles; another posture of the wrist, which is as smooth, moves the tool alike."""
    arm = load_arm(name)
    angles = moves(drawn(arm, 4))
    p, q = kinematics.poses(arm, angles)
    found = joint_path(arm, p, q)
    again_p, again_q = kinematics.poses(arm, found)
    np.testing.assert_allclose(again_p, p, atol=1e-6)
    np.testing.assert_allclose(log(multiply(conjugate(again_q), q)), 0.0, atol=1e-6)
    bends = np.abs(np.diff(found, 2, axis=0)).sum()
    assert bends < 1.05 * np.abs(np.diff(angles, 2, axis=0)).sum()


def test_through_a_singular_wrist():
    arm = load_arm("irb2400")
    targets = np.array(
        [[0.0, 0.1, 0.2, 0.3, 0.8, 0.1], [0.5, 0.0, 0.1, 0.3, -0.8, 0.2], [0.2, 0.1, 0.0, 1.3, 0.9, -0.4]]
    )
    angles = moves(targets)
    p, q = kinematics.poses(arm, angles)
    found = joint_path(arm, p.round(6), q)
    flipped = angles.copy()  # the other posture of the wrist, if that is nearer to zero at the start
    flipped[:, 3:] = np.column_stack([angles[:, 3] - np.pi, -angles[:, 4], angles[:, 5] - np.pi])
    assert min(np.abs(found - own).max() for own in (angles, flipped)) < 0.02


def test_more_joints_than_poses_determine():
    text = load_arm("kr125").urdf
    text = text.replace('type="fixed"', 'type="revolute"').replace(
        '<origin xyz="0 0 0" rpy="0 1.570796326794897 0"/>',
        '<origin xyz="0 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1"/>',
    )
    arm = parse_arm(text)
    assert len(arm.joints) == 7
    p, q = kinematics.poses(arm, np.zeros((3, 7)))
    with pytest.raises(RobotError, match="7 joints; poses alone determine six at most"):
        joint_path(arm, p, q)


def test_poses_out_of_reach():
    arm = load_arm("irb120")
    p, q = kinematics.poses(arm, moves(drawn(arm, 1)))
    with pytest.raises(RobotError, match="does not reach the first pose; is it another arm"):
        joint_path(arm, p + np.array([3.0, 0.0, 0.0]), q)
    away = p + np.linspace(0.0, 1.0, len(p))[:, None] * np.array([3.0, 0.0, 0.0])
    with pytest.raises(RobotError, match="does not reach the reported poses in one posture"):
        joint_path(arm, away, q)


def test_every_arm_of_the_library_has_a_spherical_wrist():
    """The wrist centre is the same point of the forearm for all angles of axes 4 to 6."""
    assert len(LIBRARY) > 10
    for name, entry in LIBRARY.items():
        arm = load_arm(name)
        angles = np.zeros((20, 6))
        angles[:, 3:] = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3))
        p, q = kinematics.poses(arm, angles)
        back = np.array([[0.0, 0.0, -entry.flange_distance]])
        wrist = p + np.array([_applied(one, back[0]) for one in q])
        np.testing.assert_allclose(wrist, [[entry.wrist[0], 0.0, entry.wrist[1]]] * 20, atol=1e-9, err_msg=name)


def _applied(q, v):
    return multiply(multiply(q, np.concatenate([[0.0], v])), conjugate(q))[1:]


def test_small_turns_of_the_tool_are_seen():
    """A path with standstills: the poses there are equal but for rounding."""
    arm = load_arm("irb2400")
    angles = np.repeat(moves(drawn(arm, 2, 3), 20), 3, axis=0)
    p, q = kinematics.poses(arm, angles)
    q = multiply(q, exp(np.full((len(q), 3), 1e-7)))
    found = joint_path(arm, p, q)
    np.testing.assert_allclose(kinematics.poses(arm, found)[0], p, atol=1e-6)

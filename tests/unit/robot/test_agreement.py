"""Poses that a controller reports against a model at the reported joint angles."""

from itertools import pairwise

import numpy as np
import pytest

from kreisel.geometry.rotation import matrix, multiply
from kreisel.protocols.samples import RobotSample
from kreisel.robot.agreement import Agreement, tool_of
from kreisel.robot.description import parse_arm
from kreisel.robot.kinematics import load_arm, poses

ARM = load_arm("ur10e")
SHORTER = parse_arm(ARM.urdf.replace("0.6127", "0.4784").replace("0.57155", "0.36"))  # the arm of a UR16e
WAY = np.radians([[0, -90, 60, -60, -90, 0], [40, -70, 80, -20, -50, 60], [-50, -110, 100, 40, 30, -80]])
NOTHING = np.array([1.0, 0.0, 0.0, 0.0])
TURNED = np.array([0.0, 0.0, 0.0, 1.0])


def samples(arm, base=(NOTHING, np.zeros(3)), tool=(NOTHING, np.zeros(3)), seconds=8.0, per_move=200):
    """Yield what a controller reports while its arm goes from one place to the next, in so many seconds each."""
    stamp = 0
    for a, b in pairwise(WAY):
        for share in np.linspace(0.0, 1.0, per_move):
            q = a + share * (b - a)
            (p,), (turn,) = poses(arm, q[None])
            p = matrix(base[0]) @ (p + matrix(turn) @ tool[1]) + base[1]
            stamp += round(1e9 * seconds / per_move)
            whole = multiply(multiply(base[0], turn), tool[0])
            yield RobotSample(stamp, tuple(p.tolist()), tuple(whole.tolist()), tuple(q.tolist()))


def compared(*arguments, **more):
    agreement = Agreement(ARM)
    for number, sample in enumerate(samples(*arguments, **more)):
        agreement.take(sample)
        if agreement.complaint is not None:
            return agreement, number
    return agreement, None


@pytest.mark.parametrize("base", [(NOTHING, np.zeros(3)), (np.full(4, 0.5), np.array([3.0, -2.0, 1.0]))])
@pytest.mark.parametrize("tool", [(NOTHING, np.zeros(3)), (np.full(4, 0.5), np.array([0.1, 0.2, 0.3]))])
def test_any_constant_base_and_tool_agree(base, tool):
    agreement, _ = compared(ARM, base, tool)
    assert agreement.complaint is None
    assert np.degrees(agreement.turned) > 100.0


def test_another_robot_is_noticed_before_the_first_move_is_a_third_done():
    agreement, number = compared(SHORTER)
    assert "do not follow the model 'ur10e'" in agreement.complaint
    assert number < 70


def test_a_pose_that_does_not_follow_the_joints_is_noticed():
    agreement = Agreement(ARM)
    first = next(samples(ARM))
    for sample in samples(ARM):
        agreement.take(RobotSample(sample.stamp_ns, first.position, first.quaternion, sample.joints))
    assert "turned by 0.0 deg" in agreement.complaint


def test_poses_of_a_fast_arm_are_not_compared():
    agreement, _ = compared(SHORTER, seconds=1.0)
    assert agreement.complaint is None
    assert agreement.turned == 0.0


def test_a_single_odd_pose_is_no_complaint():
    agreement = Agreement(ARM)
    for number, sample in enumerate(samples(ARM)):
        odd = number == 60
        position = (9.0, 9.0, 9.0) if odd else sample.position
        agreement.take(RobotSample(sample.stamp_ns, position, sample.quaternion, sample.joints))
    assert agreement.complaint is None


def test_the_tool_of_one_pose_is_that_for_the_better_base():
    tool = (np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]), np.array([0.0, 0.03, 0.04]))
    for base, turned in ((NOTHING, False), (TURNED, True)):
        found = tool_of(ARM, next(samples(ARM, (base, np.zeros(3)), tool)))
        assert found.turned is turned
        assert found.length == pytest.approx(0.05, abs=1e-9)
        assert found.angle == pytest.approx(np.pi / 2, abs=1e-7)
    assert tool_of(ARM, RobotSample(0, None, None, (0.0,) * 6)) is None

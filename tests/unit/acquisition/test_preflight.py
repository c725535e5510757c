"""What is checked before an arm is moved."""

import math

import numpy as np
import pytest

from kreisel.acquisition.movers import EkrlMover, UrScriptMover
from kreisel.acquisition.preflight import Allowed, approach_share, check_program, check_state
from kreisel.devices.address import MOVERS, parse_address
from kreisel.errors import RobotError
from kreisel.protocols.samples import RobotSample
from kreisel.robot.description import parse_arm
from kreisel.robot.kinematics import load_arm, poses
from kreisel.robot.motion import Move
from kreisel.robot.program import Program

ARM = load_arm("ur10e")
KUKA = load_arm("kr125")
START = np.radians([0.0, -90.0, 60.0, -60.0, -90.0, 0.0])
AWAY = np.radians([40.0, -70.0, 80.0, -20.0, -50.0, 60.0])
PROGRAM = Program(START, (Move(AWAY, 1.0), Move(START, 1.0, 0.5)))


def ur(speed=1.0):
    return UrScriptMover(parse_address("urscript://127.0.0.1", MOVERS), speed)


def kuka(share):
    return EkrlMover(parse_address("ekrl://127.0.0.1", MOVERS), share, 1.0)


def reported(joints, arm=ARM, tool=(0.0, 0.0, 0.0)):
    (p,), (q,) = poses(arm, joints[None])
    return RobotSample(0, tuple((p + np.array(tool)).tolist()), tuple(q.tolist()), tuple(joints.tolist()))


def test_the_speeds_of_joints_are_shares_of_the_leading_ones():
    velocities, accelerations = ur(1.2).peaks(np.array([0.5, -1.0, 0.0, 0.25, 0.0, 0.1]), 0.5, ARM.velocity)
    assert velocities == pytest.approx([0.3, 0.6, 0.0, 0.15, 0.0, 0.06])
    assert accelerations == pytest.approx(2.0 * velocities)


def test_no_axis_of_a_kuka_arm_is_faster_than_its_share():
    """The axis that takes longest sets the time of all."""
    velocities, accelerations = kuka(0.3).peaks(np.array([1.0, -1.0, 0.0, 2.0, 0.0, 0.1]), 0.5, KUKA.velocity)
    assert np.max(velocities / KUKA.velocity) == pytest.approx(0.15)
    assert velocities / velocities[0] == pytest.approx([1.0, 1.0, 0.0, 2.0, 0.0, 0.1])
    assert accelerations is None
    assert "within its limits" in check_program(KUKA, Program(START, (Move(START + 0.1, 1.0),)), kuka(1.0))


@pytest.mark.parametrize(("speed", "limit"), [(2.5, "2.09"), (3.2, "2.09")])
def test_a_move_faster_than_the_model_allows_is_refused(speed, limit):
    turn = np.array([1.0, 0.2, 0.0, 0.0, 0.0, 0.0])
    program = Program(START, (Move(START + 0.01, 1.0), Move(START + turn, 1.0)))
    with pytest.raises(
        RobotError, match=rf"move 2: joint_1 moves at {speed:.2f} rad/s.*{limit} rad/s; give --speed 2.09"
    ):
        check_program(ARM, program, ur(speed))
    wrist = Program(START, (Move(START + 0.01, 1.0), Move(START + turn[::-1], 1.0)))
    check_program(ARM, wrist, ur(2.5))  # the last joint may turn at 3.14 rad/s


def test_the_models_own_limits_of_acceleration_are_kept():
    described = parse_arm(ARM.urdf.replace('velocity="2.094395"', 'velocity="2.094395" acceleration="1.0"'))
    program = Program(START, (Move(START + 0.01, 1.0), Move(START + np.array([0.5, 0.2, 0, 0, 0, 0]), 1.0)))
    with pytest.raises(
        RobotError, match=r"move 2: joint_1 accelerates with 2\.00 rad/s\^2.*1\.00 rad/s\^2.*--speed 0\.5 or"
    ):
        check_program(described, program, ur(1.0))
    check_program(described, program, ur(0.5))


def test_a_model_without_limits_of_velocity_is_refused():
    with pytest.raises(RobotError, match="joint_1 has no velocity limit"):
        check_program(parse_arm(ARM.urdf.replace('velocity="2.094395"', 'velocity="0"')), PROGRAM, ur())


def test_a_target_where_the_arm_would_be_stopped_is_refused():
    edge = START.copy()
    edge[2] = math.radians(179.5)
    with pytest.raises(
        RobotError, match=r"move 1: joint_3 at 179\.5 deg is not within its limits.*-180\.0 to 180\.0 deg"
    ):
        check_program(ARM, Program(START, (Move(edge, 1.0),)), ur())


def test_the_way_to_the_start_is_slow():
    assert approach_share(PROGRAM, ur(1.0)) == 0.25
    assert approach_share(PROGRAM, ur(0.2)) == 0.5  # the program's slowest


def test_the_distance_to_the_start_is_limited():
    joints = START + np.radians([0.0, 0.0, 0.0, -25.0, 3.0, 0.0])
    with pytest.raises(RobotError, match=r"joint_4 is 25\.0 deg .*0\.0, 0\.0, 0\.0, 25\.0, -3\.0.* --approach 25"):
        check_state(ARM, PROGRAM, reported(joints), ur(), Allowed())
    _, said = check_state(ARM, PROGRAM, reported(joints), ur(), Allowed(approach=math.radians(26)))
    assert said == "the program's start is 25.0 deg away (joints: -0.0, -0.0, -0.0, 25.0, -3.0, -0.0 deg)".replace(
        "-0.0", "0.0"
    )


def test_what_was_compared_of_the_pose_is_said():
    told, _ = check_state(ARM, PROGRAM, reported(START, tool=(0.0, 0.03, 0.04)), ur(), Allowed())
    assert told.startswith("the reported pose is that of the model 'ur10e' with a tool of 50 mm, turned by 0.0 deg;")
    told, _ = check_state(ARM, PROGRAM, reported(START, tool=(3.0, 0.0, 0.0)), ur(), Allowed(tool=None))
    assert "base and tool of the controller are not known: poses are compared while the arm moves" in told
    told, _ = check_state(ARM, PROGRAM, RobotSample(0, None, None, tuple(START)), ur(), Allowed())
    assert told == "the controller reports no pose: it is not compared with the model"


def test_another_robot_is_refused():
    with pytest.raises(RobotError, match=r"only with a tool of \d+ mm.*another robot.*--longest-tool"):
        check_state(ARM, PROGRAM, reported(START, tool=(0.4, 0.0, 0.0)), ur(), Allowed())
    with pytest.raises(RobotError, match="reports 7 joint angles, and the model 'ur10e' has 6 joints"):
        check_state(ARM, PROGRAM, RobotSample(0, None, None, (0.0,) * 7), ur(), Allowed())

"""Which arm poses show: found where axes 2 and 3 stand still, and silence where they do not."""

import itertools

import numpy as np
import pytest

from kreisel.geometry.rotation import exp, multiply
from kreisel.robot import kinematics
from kreisel.robot.arm_library import LIBRARY, Tool
from kreisel.robot.description import parse_arm
from kreisel.robot.identification import identified, steady_wrist

TURNED = Tool((0.0, 0.0, 0.15), (0.0, 1.0, 0.0, 0.0))


def wrist_moves(seed=0, count=8, shoulder=0.0, elbow=0.0):
    """Joint angles of moves of axes 1, 4, 5 and 6; shoulder and elbow stand."""
    rng = np.random.default_rng(seed)
    targets = np.column_stack([
        rng.uniform(-2.0, 2.0, count), np.full(count, shoulder), np.full(count, elbow),
        *rng.uniform(-1.5, 1.5, (3, count)),
    ])  # fmt: skip
    s = np.linspace(0.0, 1.0, 40)[:, None]
    return np.vstack([a + (b - a) * s for a, b in itertools.pairwise(targets)])


def seen(name, angles, tool=TURNED):
    arm = parse_arm(LIBRARY[name].urdf(tool))
    return kinematics.poses(arm, angles)


@pytest.mark.parametrize("name", ["irb2400", "kr16", "irb120", "gp25"])
def test_the_arm_and_its_tool(name):
    p, q = seen(name, wrist_moves(shoulder=np.radians(15.0), elbow=np.radians(-20.0)))
    wrist = steady_wrist(p.round(5), q)
    (found,) = identified(wrist)
    assert found.arm.name == name
    assert wrist.share == 1.0
    np.testing.assert_allclose(found.tool.position, TURNED.position, atol=1e-4)


def test_its_poses_are_those_seen():
    """Up to a turn about the flange's axis, which is that of axis 6."""
    angles = wrist_moves()
    p, q = seen("irb2400", angles)
    (found,) = identified(steady_wrist(p, q))
    arm = parse_arm(found.arm.urdf(found.tool))
    p0, q0 = kinematics.poses(arm, angles)
    np.testing.assert_allclose(p0, p, atol=1e-6)
    turn = multiply(q0 * np.array([1.0, -1.0, -1.0, -1.0]), q)
    np.testing.assert_allclose(np.abs(turn[:, [1, 2]]).max() * np.abs(turn[:, [0, 3]]).min(), 0.0, atol=1e-9)


def test_silence_where_the_poses_do_not_show_it():
    rng = np.random.default_rng(1)
    moving = wrist_moves()
    moving[:, 1] += 0.3 * np.sin(np.arange(len(moving)) / 15.0)
    assert steady_wrist(*seen("irb2400", moving)) is None  # the shoulder moves
    uneven = wrist_moves(shoulder=0.123, elbow=0.077)
    assert identified(steady_wrist(*seen("irb2400", uneven))) == ()  # at no whole angles
    about_one_axis = np.zeros((100, 6))
    about_one_axis[:, 4] = np.linspace(0.0, 1.5, 100)
    assert steady_wrist(*seen("irb2400", about_one_axis)) is None
    bent = Tool((0.05, 0.0, 0.1))
    assert identified(steady_wrist(*seen("irb2400", wrist_moves(), bent))) == ()
    p, q = seen("irb2400", wrist_moves())
    by_hand = p + np.cumsum(rng.normal(size=p.shape) * 1e-3, axis=0)
    assert steady_wrist(by_hand, multiply(q, exp(1e-3 * rng.normal(size=p.shape)))) is None
    assert steady_wrist(p[:5], q[:5]) is None

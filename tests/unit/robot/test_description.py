"""Descriptions of arms against pinocchio's reader, and what is wrong with them in one line."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from kreisel.errors import RobotError
from kreisel.robot import kinematics
from kreisel.robot.description import parse_arm
from kreisel.robot.urdf import calibrated_urdf
from kreisel.units import STANDARD_GRAVITY

KINDS = ("revolute", "revolute", "prismatic", "fixed", "floating", "planar")
LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="10"/>'


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


def random_urdf(seed, count=14):
    """Links on random others, by joints of any kind, in any order and with any names; most have a mass."""
    rng = np.random.default_rng(seed)
    names = [f"n{k}" for k in rng.permutation(count)]
    parts = []
    for k, name in enumerate(names):
        inertial = (
            f'<inertial><origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.normal(size=3))}"/>'
            f'<mass value="{rng.uniform(0.5, 5.0)!r}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        parts.append(f'<link name="{name}">{inertial if rng.random() < 0.8 else ""}</link>')
        if k == 0:
            continue
        kind = KINDS[rng.integers(3 if rng.random() < 0.8 else len(KINDS))]
        axis = rng.normal(size=3) if rng.random() < 0.5 else rng.permutation([0.0, 0.0, rng.choice([-1.0, 2.0])])
        parts.append(
            f'<joint name="{rng.choice(["a", "B", "_"])}{name}" type="{kind}">'
            f'<parent link="{names[rng.integers(max(0, k - 3), k)]}"/><child link="{name}"/>'
            f'<origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.uniform(-3.0, 3.0, 3))}"/>'
            f'<axis xyz="{numbers(axis)}"/>{LIMIT if kind in ("revolute", "prismatic") else ""}</joint>'
        )
    return f'<robot name="tree">{"".join(np.array(parts)[rng.permutation(len(parts))])}</robot>'


def of_pinocchio(urdf, tcp=None):
    """The model with all joints that do not move the tool at rest, and the number of the tool's frame."""
    model = pin.buildModelFromXML(urdf)
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]

    def moved_by(name):
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        return list(model.supports[frame.parentJoint])[1:]

    if tcp is None:
        most = max(len(moved_by(frame.name)) for frame in bodies)
        tcp = [frame.name for frame in bodies if len(moved_by(frame.name)) == most][-1]
    moving = moved_by(tcp)
    others = [j for j in range(1, model.njoints) if j not in moving]
    model = pin.buildReducedModel(model, others, pin.neutral(model))
    return model, tcp, model.getFrameId(tcp, pin.FrameType.BODY)


@pytest.mark.parametrize("seed", range(40))
def test_any_tree_is_read_as_pinocchio_reads_it(seed):
    urdf = random_urdf(seed)
    model, tcp, frame = of_pinocchio(urdf)
    if model.nq != model.nv or model.nv == 0:
        with pytest.raises(RobotError, match=r"each joint must have one angle|no joint moves"):
            parse_arm(urdf)
        return
    arm = parse_arm(urdf)
    assert (arm.name, arm.tcp, arm.joints) == ("tree", tcp, tuple(model.names)[1:])
    for own, expected in (
        (arm.lower, model.lowerPositionLimit),
        (arm.upper, model.upperPositionLimit),
        (arm.velocity, model.velocityLimit),
    ):
        np.testing.assert_array_equal(own, expected)
    angles = np.random.default_rng(seed).uniform(-2.0, 2.0, (4, len(arm.joints)))
    p, q = kinematics.poses(arm, angles)
    torques = kinematics.gravity_torques(arm, angles)
    model.gravity.linear = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    data = model.createData()
    for k, own in enumerate(angles):
        pin.forwardKinematics(model, data, own)
        there = pin.updateFramePlacement(model, data, frame)
        np.testing.assert_allclose(p[k], there.translation, atol=1e-12)
        np.testing.assert_allclose(Rotation.from_quat(q[k], scalar_first=True).as_matrix(), there.rotation, atol=1e-12)
        np.testing.assert_allclose(torques[k], pin.computeGeneralizedGravity(model, data, own), atol=1e-9)
        points = np.vstack([np.zeros(3), *(joint.translation for joint in data.oMi[1:]), there.translation])
        np.testing.assert_allclose(kinematics.skeleton(arm, own), points, atol=1e-12)


def test_random_trees_are_worth_reading():
    """Most of them have a tool that several joints of both kinds move, and something beside it."""
    models = [of_pinocchio(random_urdf(seed))[0] for seed in range(40)]
    fit = [model for model in models if model.nq == model.nv >= 3]
    assert len(fit) > 15
    kinds = {type(joint.extract()).__name__ for model in fit for joint in list(model.joints)[1:]}
    assert any("Prismatic" in kind or "JointModelP" in kind for kind in kinds)


# What cannot be read

LINKS = '<link name="base"/><link name="tool"/>'
JOINT = (
    '<joint name="j" type="revolute"><parent link="base"/><child link="tool"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" velocity="2"/></joint>'
)


def test_the_least_description_is_read():
    assert parse_arm(f"<robot>{LINKS}{JOINT}</robot>").joints == ("j",)


@pytest.mark.parametrize(
    ("content", "telling"),
    [
        (LINKS + JOINT.replace('xyz="0 0 1"', 'xyz="0 0 0"'), "axis of joint 'j' is zero"),
        (LINKS + JOINT.replace('xyz="0 0 1"', 'xyz="0 one 0"'), "axis of joint 'j' is '0 one 0', expected 3 numbers"),
        (LINKS + JOINT.replace('xyz="0 0 1"', 'xyz="0 nan 0"'), "axis of joint 'j' is '0 nan 0', expected 3 numbers"),
        (LINKS + JOINT.replace("revolute", "hinge"), "is of type 'hinge', expected one of revolute, continuous"),
        (LINKS + JOINT.replace('<parent link="base"/>', ""), "joint 'j' has no <parent>"),
        (LINKS + JOINT.replace('<child link="tool"/>', "<child/>"), "the child of joint 'j' has no link"),
        (LINKS + JOINT.replace('link="tool"', 'link="tcp"'), "names the link 'tcp', which does not exist"),
        (LINKS + JOINT.replace(' velocity="2"', ""), "the limit of joint 'j' has no velocity"),
        (LINKS + JOINT.replace('<limit lower="-1" upper="1" velocity="2"/>', ""), "has no <limit>"),
        (LINKS + JOINT.replace('lower="-1"', 'lower=""'), "lower of the limit of joint 'j' is '', expected a number"),
        (LINKS + JOINT + JOINT, "two joints are named 'j'"),
        (LINKS + JOINT + JOINT.replace('"j"', '"k"'), "two joints carry the link 'tool': j, k"),
        (LINKS + LINKS + JOINT, "two links are named 'base'"),
        (LINKS, "2 links hang on no joint (base, tool), expected one"),
        (LINKS + JOINT.replace('link="base"', 'link="tool"'), "links carry each other in a circle: tool"),
        (JOINT, "it has no <link>"),
        ('<link name="base"><inertial/></link>', "link 'base': <inertial> without <mass>"),
        ('<link name="base"><inertial><mass value="-1"/></inertial></link>', "mass of link 'base' is -1 kg"),
        ('<link/>', "a link has no name"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(content, telling):
    with pytest.raises(RobotError) as caught:
        parse_arm(f"<robot>{content}</robot>", source="arm.urdf")
    message = str(caught.value)
    assert message.startswith("arm.urdf: not a robot description (URDF): ")
    assert telling in message


def test_too_many_joints_are_refused():
    text = "".join(f'<link name="l{k}"/>' for k in range(66))
    for k in range(65):
        text += JOINT.replace('"j"', f'"j{k}"').replace('"base"', f'"l{k}"').replace('"tool"', f'"l{k + 1}"')
    with pytest.raises(RobotError, match="65 joints move 'l65'; expected 64 at most"):
        parse_arm(f"<robot>{text}</robot>")


# The description with errors


@pytest.mark.parametrize("pitch", [0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9])
def test_written_angles_are_those_of_the_arm(pitch):
    """Near a pitch of 90 deg, usual for such arms, angles are not unique, but what they mean is."""
    text = f"<robot>{LINKS}{JOINT}</robot>".replace("<axis", f'<origin xyz="1 2 3" rpy="0.4 {pitch!r} -0.7"/><axis')
    arm = parse_arm(text)
    errors = 1e-3 * np.random.default_rng(2).normal(size=(2, 6))
    expected = kinematics.poses(kinematics.with_placement_errors(arm, errors), np.array([[0.3]]))
    again = kinematics.poses(parse_arm(calibrated_urdf(arm, errors)), np.array([[0.3]]))
    for own, other in zip(again, expected, strict=True):
        np.testing.assert_allclose(own, other, atol=1e-11)


@pytest.mark.parametrize("model", ["kr125", "irb2400"])
def test_zeros_move_the_description_as_the_joints_do(model):
    arm, zeros = kinematics.load_arm(model), np.array([0.03, -0.02, 0.05, 0.01])
    errors = 1e-3 * np.random.default_rng(2).normal(size=(7, 6))
    angles = np.random.default_rng(3).uniform(-0.5, 0.5, (5, 6))
    moved = angles + np.concatenate([[0.0], zeros, [0.0]])
    expected = kinematics.poses(kinematics.with_placement_errors(arm, errors), moved)
    again = kinematics.poses(parse_arm(calibrated_urdf(arm, errors, zeros), arm.tcp), angles)
    for own, other in zip(again, expected, strict=True):
        np.testing.assert_allclose(own, other, atol=1e-10)


def test_transmissions_are_no_joints():
    """They name the joint again; the error belongs to the joint itself."""
    text = f'<robot>{LINKS}{JOINT}<transmission name="t"><joint name="j"/></transmission></robot>'
    arm = parse_arm(text)
    errors = np.zeros((2, 6))
    errors[0, 0] = 0.01
    again = parse_arm(calibrated_urdf(arm, errors))
    np.testing.assert_allclose(kinematics.poses(again, np.zeros((1, 1)))[0], [[0.01, 0.0, 0.0]], atol=1e-15)

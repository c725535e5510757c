"""Where the tool stands and how it moves, against Denavit-Hartenberg products and finite differences."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from math import factorial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from kreisel.errors import RobotError
from kreisel.robot import kinematics
from kreisel.robot.description import parse_arm
from kreisel.robot.excitation import home
from kreisel.robot.kinematics import MODELS, load_arm
from kreisel.units import STANDARD_GRAVITY


@dataclass(frozen=True)
class DenavitHartenberg:
    """Standard parameters in m and deg, and the sense in which each joint counts."""

    a: tuple[float, ...]
    alpha: tuple[float, ...]
    d: tuple[float, ...]
    theta: tuple[float, ...]
    direction: tuple[float, ...]

    def pose(self, angles):
        """Rz(theta) Tz(d) Tx(a) Rx(alpha), joint after joint."""
        T = np.eye(4)
        rows = zip(angles, self.a, self.alpha, self.d, self.theta, self.direction, strict=True)
        for q, a, alpha, d, theta, direction in rows:
            turn, shift = np.eye(4), np.eye(4)
            turn[:3, :3] = Rotation.from_euler("z", np.radians(theta) + direction * q).as_matrix()
            shift[:3, :3] = Rotation.from_euler("x", alpha, degrees=True).as_matrix()
            shift[:3, 3] = a, 0.0, d
            T = T @ turn @ shift
        return T


TABLES = {
    # KUKA KR 125: published table, mm there
    "kr125": DenavitHartenberg(
        a=(0.410, 1.0, 0.045, 0.0, 0.0, 0.0),
        alpha=(-90.0, 0.0, 90.0, -90.0, 90.0, 180.0),
        d=(0.865, 0.0, 0.0, -1.0, 0.0, -0.210),
        theta=(0.0, 0.0, -90.0, 0.0, 0.0, 180.0),
        direction=(-1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    ),
    # Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR10e
    "ur10e": DenavitHartenberg(
        a=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
        alpha=(90.0, 0.0, 0.0, 90.0, -90.0, 0.0),
        d=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
        theta=(0.0,) * 6,
        direction=(1.0,) * 6,
    ),
}

HOME = np.radians([[0.0, -90.0, 90.0, 0.0, 0.0, 0.0]])


@pytest.fixture(scope="module", params=MODELS)
def arm(request):
    return load_arm(request.param)


def random_angles(arm, count, seed=0):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, len(arm.joints)))


def matrices(q):
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def central(f, h, order, accuracy=8):
    """Derivative of f at 0 by central differences; f gives an array for a number."""
    steps = np.arange(-accuracy // 2, accuracy // 2 + 1)
    right = np.zeros(accuracy + 1)
    right[order] = factorial(order)
    weights = np.linalg.solve(np.vander(steps, increasing=True).T.astype(float), right)
    return sum(w * f(k * h) for k, w in zip(steps, weights, strict=True)) / h**order


def small_rotation(q_from, q_to):
    """Right perturbation that leads from one to the other, (n, 3)."""
    back = Rotation.from_quat(q_from, scalar_first=True).inv()
    return (back * Rotation.from_quat(q_to, scalar_first=True)).as_rotvec()


# Forward kinematics


@pytest.mark.parametrize("name", MODELS)
def test_pose_is_the_denavit_hartenberg_product(name):
    arm = load_arm(name)
    angles = random_angles(arm, 200)
    p, q = kinematics.poses(arm, angles)
    T = np.array([TABLES[name].pose(row) for row in angles])
    np.testing.assert_allclose(p, T[:, :3, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(matrices(q), T[:, :3, :3], rtol=0, atol=1e-12)


def test_home_of_the_kr125():
    """The figure of the maker: flange 1620 mm before and 1910 mm above the base, its axis forward."""
    p, q = kinematics.poses(load_arm("kr125"), HOME)
    np.testing.assert_allclose(p[0], [1.620, 0.0, 1.910], rtol=0, atol=1e-12)
    np.testing.assert_allclose(matrices(q)[0][:, 2], [1.0, 0.0, 0.0], rtol=0, atol=1e-12)


def test_first_joint_of_the_kr125_counts_clockwise():
    p, _ = kinematics.poses(load_arm("kr125"), HOME + np.radians([30.0, 0, 0, 0, 0, 0]))
    assert np.degrees(np.arctan2(p[0, 1], p[0, 0])) == pytest.approx(-30.0, abs=1e-9)


def test_repeated_rows_repeat_poses(arm):
    """Rows equal to the one before are not computed again; each must still carry its own pose."""
    angles = np.repeat(random_angles(arm, 4), [1, 3, 2, 1], axis=0)
    p, q = kinematics.poses(arm, angles)
    for k, row in enumerate(angles):
        alone, turned = kinematics.poses(arm, row[None])
        np.testing.assert_array_equal(p[k], alone[0])
        assert abs(q[k] @ turned[0]) == pytest.approx(1.0, abs=1e-15)


def test_quaternions_do_not_jump(arm):
    """Neighbours 1 deg apart differ by 2 sin(0.25 deg) at the most, over nearly two turns of the last joint."""
    angles = np.tile([0.3, -1.2, 1.4, 0.2, 0.5, 0.0], (680, 1))
    angles[:, 5] = np.radians(np.linspace(-340.0, 340.0, 680))
    expected = 2.0 * np.sin(np.radians(680.0 / 679.0) / 4.0)
    for q in (kinematics.poses(arm, angles)[1], kinematics.motion(arm, angles, 0 * angles, 0 * angles).quaternions):
        np.testing.assert_allclose(np.linalg.norm(np.diff(q, axis=0), axis=1), expected, rtol=1e-9)


# Motion along a path


def smooth_path(t):
    """Angles, rates and accelerations: two sines a joint, up to 4 rad/s^2."""
    rng = np.random.default_rng(3)
    middle = np.array([0.2, -1.2, 1.2, 0.4, 0.6, -0.5])
    size, frequency, phase = rng.uniform(0.1, 0.3, (2, 6)), rng.uniform(1.0, 3.5, (2, 6)), rng.uniform(0, 6, (2, 6))
    angle = frequency * np.asarray(t)[:, None, None] + phase
    return (
        middle + np.sum(size * np.sin(angle), axis=1),
        np.sum(size * frequency * np.cos(angle), axis=1),
        -np.sum(size * frequency**2 * np.sin(angle), axis=1),
    )


def test_motion_is_the_derivative_of_the_poses(arm):
    """Eighth order, 4 ms: motion of 15 rad/s leaves (0.06)^8 = 2e-10; rounding, 1e-15 m / (4 ms)^2, is 6e-11."""
    t = np.linspace(0.0, 20.0, 50)
    found = kinematics.motion(arm, *smooth_path(t))

    def position(h):
        return kinematics.poses(arm, smooth_path(t + h)[0])[0]

    def orientation(h):
        return matrices(kinematics.poses(arm, smooth_path(t + h)[0])[1])

    h, back = 0.004, np.swapaxes(orientation(0.0), 1, 2)
    rate = back @ central(orientation, h, 1)  # [omega x] in the tool's frame
    np.testing.assert_allclose(found.positions, position(0.0), rtol=0, atol=1e-14)
    np.testing.assert_allclose(matrices(found.quaternions), orientation(0.0), rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.velocities, central(position, h, 1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.accelerations, central(position, h, 2), rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.rates, vector(rate), rtol=0, atol=1e-9)
    # C'' = C ([alpha x] + [omega x]^2)
    change = back @ central(orientation, h, 2) - rate @ rate
    np.testing.assert_allclose(found.angular_accelerations, vector(change), rtol=0, atol=1e-8)
    assert np.abs(found.angular_accelerations).max() > 1.0  # the path tells something


def vector(S):
    """Of skew-symmetric matrices; fails where they are not."""
    np.testing.assert_allclose(S, -np.swapaxes(S, 1, 2), rtol=0, atol=1e-7)
    return np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=1) / 2.0


# Small errors


def plain_pose(urdf, angles, errors):
    """The tool's pose, from the text of the description: placement, its error, turn of the joint; last the tool's."""
    T, k = np.eye(4), 0
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        origin = joint.find("origin")
        T = T @ rigid(numbers(origin, "xyz"), Rotation.from_euler("xyz", numbers(origin, "rpy")))
        if joint.get("type") == "revolute":
            axis = angles[k] * numbers(joint.find("axis"), "xyz")
            T = T @ small_motion(errors[k]) @ rigid(np.zeros(3), Rotation.from_rotvec(axis))
            k += 1
    return T @ small_motion(errors[k])


def small_motion(error):
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = np.cross(np.eye(3), error[3:]), error[:3]
    return expm(twist)


def numbers(element, name):
    return np.array([float(part) for part in element.get(name).split()])


def rigid(position, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def test_placement_errors_move_the_joints(arm):
    """Errors of 30 mm and 30 mrad, no small ones, against the chain multiplied out."""
    rng = np.random.default_rng(1)
    for angles in random_angles(arm, 5, seed=1):
        errors = rng.normal(0.0, 0.03, (7, 6))
        p, q = kinematics.poses(kinematics.with_placement_errors(arm, errors), angles[None])
        T = plain_pose(arm.urdf, angles, errors)
        np.testing.assert_allclose(p[0], T[:3, 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(matrices(q)[0], T[:3, :3], rtol=0, atol=1e-12)


def test_placement_errors_leave_the_arm_itself(arm):
    angles = random_angles(arm, 1)
    before = kinematics.poses(arm, angles)[0]
    kinematics.with_placement_errors(arm, np.full((7, 6), 0.1))
    np.testing.assert_array_equal(kinematics.poses(arm, angles)[0], before)


def test_regressor_is_the_derivative_to_placement_errors(arm):
    """Sixth order, steps of 1e-3: (1e-3)^6 is nothing, rounding 1e-15 / 1e-3 = 1e-12."""
    angles = random_angles(arm, 6, seed=2)
    p, q = kinematics.poses(arm, angles)
    J = kinematics.derivatives(arm, angles).regressor
    assert J.shape == (6, 6, 42)
    for column in range(42):

        def moved(h, column=column):
            errors = np.zeros(42)
            errors[column] = h
            p_h, q_h = kinematics.poses(kinematics.with_placement_errors(arm, errors.reshape(7, 6)), angles)
            return np.hstack([p_h - p, small_rotation(q, q_h)])

        np.testing.assert_allclose(J[:, :, column], central(moved, 1e-3, 1, 6), rtol=0, atol=2e-11)


def test_joint_jacobian_is_the_derivative_to_angles(arm):
    angles = random_angles(arm, 20, seed=4)
    p, q = kinematics.poses(arm, angles)
    J = kinematics.derivatives(arm, angles).jacobian
    for joint in range(6):

        def moved(h, joint=joint):
            p_h, q_h = kinematics.poses(arm, angles + h * np.eye(6)[joint])
            return np.hstack([p_h - p, small_rotation(q, q_h)])

        np.testing.assert_allclose(J[:, :, joint], central(moved, 1e-2, 1, 8), rtol=0, atol=2e-11)


def test_joint_jacobian_is_part_of_the_regressor(arm):
    """A joint that turns by d about its axis is a placement that turns by d about it."""
    angles = random_angles(arm, 5, seed=5)
    joints = [j for j in ElementTree.fromstring(arm.urdf).iter("joint") if j.get("type") == "revolute"]
    axes = np.array([numbers(joint.find("axis"), "xyz") for joint in joints])
    about = np.zeros((42, 6))
    for joint, axis in enumerate(axes):
        about[6 * joint + 3 : 6 * joint + 6, joint] = axis
    found = kinematics.derivatives(arm, angles).regressor @ about
    np.testing.assert_allclose(found, kinematics.derivatives(arm, angles).jacobian, rtol=0, atol=1e-12)


def potential_energy(urdf, angles):
    """Of all links' masses in standard gravity, J; the links hang one on the other in the order of the file."""
    root = ElementTree.fromstring(urdf)
    links = {link.get("name"): link for link in root.iter("link")}
    T, energy, k = np.eye(4), 0.0, 0
    for joint in root.iter("joint"):
        origin = joint.find("origin")
        T = T @ rigid(numbers(origin, "xyz"), Rotation.from_euler("xyz", numbers(origin, "rpy")))
        if joint.get("type") == "revolute":
            T = T @ rigid(np.zeros(3), Rotation.from_rotvec(angles[k] * numbers(joint.find("axis"), "xyz")))
            k += 1
        inertial = links[joint.find("child").get("link")].find("inertial")
        if inertial is not None:
            mass = float(inertial.find("mass").get("value"))
            energy += STANDARD_GRAVITY * mass * (T @ [*numbers(inertial.find("origin"), "xyz"), 1.0])[2]
    return energy


def test_gravity_torques_are_the_slope_of_the_potential_energy(arm):
    """Energies of 1e4 J and steps of 10 mrad: rounding is 1e-12 J / 0.01 = 1e-10 N m."""
    angles = random_angles(arm, 5, seed=6)
    found = kinematics.gravity_torques(arm, angles)
    for row, torques in zip(angles, found, strict=True):
        slope = [central(lambda h, r=row, e=e: potential_energy(arm.urdf, r + h * e), 1e-2, 1) for e in np.eye(6)]
        np.testing.assert_allclose(torques, slope, rtol=0, atol=5e-9)
    assert np.abs(found[:, 1]).max() > 10.0


# Inverse kinematics


def test_inverse_leads_back_to_the_pose(arm):
    """From 0.1 rad beside; wrist and elbow bent, so that the angles are determined to 1e-10 / 0.1."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        angles = rng.uniform([-2.0, -1.9, 0.6, -2.5, 0.5, -2.5], [2.0, -0.6, 1.6, 2.5, 1.5, 2.5])
        p, q = kinematics.poses(arm, angles[None])
        found = kinematics.inverse(arm, p[0], q[0], angles + rng.uniform(-0.1, 0.1, 6))
        np.testing.assert_allclose(found, angles, rtol=0, atol=1e-8)


def test_inverse_comes_from_afar(arm):
    """Another configuration may be found, but it has the pose; the iteration ends below 1e-10."""
    target = np.array([0.8, -1.3, 1.1, 0.5, 0.9, -0.4])
    start = np.array([-0.2, -1.0, 1.4, 0.0, 0.5, 0.3])
    p, q = kinematics.poses(arm, target[None])
    found = kinematics.inverse(arm, p[0], q[0], start)
    p_found, q_found = kinematics.poses(arm, found[None])
    np.testing.assert_allclose(p_found, p, rtol=0, atol=1e-9)
    assert np.linalg.norm(small_rotation(q, q_found)) < 1e-9


def test_inverse_keeps_to_the_ranges_by_whole_turns():
    """Joint 6 of the KR 125 at 370 deg is beyond 350 deg, and the same pose as 10 deg."""
    arm = load_arm("kr125")
    angles = np.radians([10.0, -80.0, 90.0, 20.0, 50.0, 10.0])
    p, q = kinematics.poses(arm, angles[None])
    start = angles + np.array([0, 0, 0, 0, 0, 2.0 * np.pi])
    np.testing.assert_allclose(kinematics.inverse(arm, p[0], q[0], start), angles, rtol=0, atol=1e-8)
    # but 200 deg is no reason to turn back to -160 deg
    angles[5] = np.radians(200.0)
    p, q = kinematics.poses(arm, angles[None])
    np.testing.assert_allclose(kinematics.inverse(arm, p[0], q[0], angles + 0.01), angles, rtol=0, atol=1e-8)


def test_inverse_says_what_is_out_of_reach():
    """From joint 2, at (0.410, 0, 0.865), the flange of the KR 125 is at most 1 + |(1, 0.045)| + 0.21 m away."""
    arm = load_arm("kr125")
    target = np.array([5.0, 0.0, 1.0])
    nearest = np.linalg.norm(target - [0.410, 0.0, 0.865]) - (1.0 + np.hypot(1.0, 0.045) + 0.210)
    with pytest.raises(RobotError, match=r"out of reach: the arm comes no nearer than \d\.\d+ m") as caught:
        kinematics.inverse(arm, target, np.array([1.0, 0.0, 0.0, 0.0]), HOME[0])
    found = float(str(caught.value).split()[-2])
    # orientation counts too, a radian like a metre: the arm does not stretch fully towards the target
    assert nearest - 1e-3 <= found < nearest + 1.0


# Ranges


def test_ranges_of_the_kr125():
    """Of the published table, deg and deg/s; the file has six decimals of a radian."""
    arm = load_arm("kr125")
    assert arm.joints == tuple(f"joint_{k}" for k in range(1, 7))
    assert arm.tcp == "tool0"
    lower, upper = (-185, -130, -120, -350, -120, -350), (185, 3, 148, 350, 120, 350)
    np.testing.assert_allclose(np.degrees(arm.lower), lower, rtol=0, atol=5e-5)
    np.testing.assert_allclose(np.degrees(arm.upper), upper, rtol=0, atol=5e-5)


def test_range_check_names_joint_and_limit():
    arm = load_arm("kr125")
    inside = 0.5 * (arm.lower + arm.upper)
    kinematics.check_range(arm, inside)
    kinematics.check_range(arm, arm.lower)  # the limits themselves belong to the range
    kinematics.check_range(arm, arm.upper)
    for joint in range(6):
        for beyond in (arm.lower[joint] - 0.01, arm.upper[joint] + 0.01):
            angles = inside.copy()
            angles[joint] = beyond
            with pytest.raises(RobotError) as caught:
                kinematics.check_range(arm, angles)
            message = str(caught.value)
            assert message.startswith(f"joint_{joint + 1} at {np.degrees(beyond):.2f} deg")
            assert f"{np.degrees(arm.lower[joint]):.1f} to {np.degrees(arm.upper[joint]):.1f} deg" in message


def test_range_check_wants_an_angle_for_every_joint(arm):
    with pytest.raises(RobotError, match="5 joint angles, expected 6: joint_1, .*joint_6"):
        kinematics.check_range(arm, [0.0] * 5)


# Descriptions


def joint(name, kind, parent, child, axis="0 0 1", inside='<limit lower="-1" upper="1" velocity="2" effort="10"/>'):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0.1" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>{inside}</joint>'
    )


def links(*names):
    return "".join(f'<link name="{name}"/>' for name in names)


ELBOW = joint("shoulder", "revolute", "base", "upper") + joint("elbow", "revolute", "upper", "lower", "0 1 0")
TOOL = joint("mount", "fixed", "lower", "tcp", inside="")
PLAIN = f'<robot name="two">{links("base", "upper", "lower", "tcp")}{ELBOW}{TOOL}</robot>'
GRIPPER = (
    f'<robot name="two">{links("base", "upper", "lower", "tcp", "left", "right")}'
    f"{joint('finger_l', 'prismatic', 'lower', 'left')}{joint('finger_r', 'prismatic', 'lower', 'right')}"
    f"{ELBOW}{TOOL}</robot>"
)


def test_a_description_in_a_file(tmp_path):
    file = tmp_path / "two.urdf"
    file.write_text(PLAIN, encoding="utf-8")
    arm = load_arm(file)
    assert (arm.name, arm.joints, arm.tcp, arm.urdf) == ("two", ("shoulder", "elbow"), "tcp", PLAIN)
    angles = np.array([[0.4, -0.7]])
    expected = plain_pose(PLAIN, angles[0], np.zeros((3, 6)))
    p, q = kinematics.poses(arm, angles)
    np.testing.assert_allclose(p[0], expected[:3, 3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(matrices(q)[0], expected[:3, :3], rtol=0, atol=1e-14)


def test_other_joints_do_not_move_the_tool():
    """Fingers hang beside the tool: they are no joints of the arm, and the pose is that without them."""
    with_gripper, plain = parse_arm(GRIPPER, "tcp"), parse_arm(PLAIN)
    assert with_gripper.joints == plain.joints == ("shoulder", "elbow")
    assert with_gripper.tcp == "tcp"
    angles = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 2))
    np.testing.assert_allclose(
        kinematics.poses(with_gripper, angles)[0], kinematics.poses(plain, angles)[0], rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(
        kinematics.derivatives(with_gripper, angles).regressor,
        kinematics.derivatives(plain, angles).regressor,
        rtol=0,
        atol=1e-14,
    )


def test_a_frame_in_the_middle_ends_the_chain():
    arm = parse_arm(PLAIN, "upper")
    assert arm.joints == ("shoulder",)
    np.testing.assert_allclose(kinematics.poses(arm, np.array([[0.5]]))[0], [[0.3, 0.0, 0.1]], rtol=0, atol=1e-15)


def test_endless_joints_are_joints():
    """Without any limit, and with one that has only a speed; the angle is one number, turns are counted."""
    bare = PLAIN.replace('type="revolute"', 'type="continuous"')
    for text, speed in ((bare, 2.0), (bare.replace('<limit lower="-1" upper="1" velocity="2" effort="10"/>', ""), 3.0)):
        arm = parse_arm(text)
        np.testing.assert_array_equal(arm.velocity, [speed, speed])
        assert np.all(arm.lower < -6.0 * np.pi)
        assert np.all(arm.upper > 6.0 * np.pi)
        once, thrice = (kinematics.poses(arm, np.array([[0.4, 0.2 + turns]]))[0] for turns in (0.0, 4.0 * np.pi))
        np.testing.assert_allclose(once, thrice, rtol=0, atol=1e-14)


def test_meshes_are_not_looked_for():
    mesh = '<geometry><mesh filename="package://nowhere/{}.stl"/></geometry>'
    shapes = f"<visual>{mesh.format('a')}</visual><collision>{mesh.format('b')}</collision>"
    arm = parse_arm(PLAIN.replace('<link name="upper"/>', f'<link name="upper">{shapes}</link>'))
    angles = np.array([[0.4, -0.7]])
    np.testing.assert_array_equal(kinematics.poses(arm, angles)[0], kinematics.poses(parse_arm(PLAIN), angles)[0])


@pytest.mark.parametrize("source", ["kr126", "KR125", "robot.txt", ""])
def test_an_unknown_model_lists_the_known_ones(source):
    with pytest.raises(RobotError, match=f"unknown robot '{source}'; known are: gp25, .*, kr125, .*, ur10e; or"):
        load_arm(source)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(RobotError, match=r"none\.urdf: cannot be read: No such file"):
        load_arm(tmp_path / "none.urdf")


@pytest.mark.parametrize(
    ("content", "telling"),
    [
        (b"joints: 6\n", "not XML: syntax error: line 1"),
        (PLAIN[:90].encode(), "not XML"),
        (b"\xff\xfe\x00", "not UTF-8"),
    ],
)
def test_not_xml(tmp_path, content, telling):
    file = tmp_path / "robot.urdf"
    file.write_bytes(content)
    with pytest.raises(RobotError, match=telling) as caught:
        load_arm(file)
    assert str(file) in str(caught.value)
    assert "expected a robot's description (URDF)" in str(caught.value)


def test_xml_that_describes_no_robot():
    with pytest.raises(RobotError, match="cell.xml: not a robot description"):
        parse_arm("<cell/>", source="cell.xml")


def test_an_unknown_frame_lists_the_frames():
    with pytest.raises(RobotError, match="unknown frame 'flange'; known are: base, left, lower, right, tcp, upper"):
        parse_arm(GRIPPER, "flange")
    with pytest.raises(RobotError, match="unknown frame 'tcp'; known are: base_link, .*, tool0"):
        load_arm("kr125", "tcp")


def test_a_frame_that_no_joint_moves():
    with pytest.raises(RobotError, match="no joint moves 'base'; name the tool's frame, one of base, upper"):
        parse_arm(PLAIN, "base")


def test_a_joint_may_share_its_links_name():
    text = PLAIN.replace('name="shoulder" type="revolute"', 'name="upper" type="revolute"')
    assert parse_arm(text, "upper").joints == ("upper",)


@pytest.mark.parametrize("model", ["kr125", "ur10e"])
def test_home_is_no_singularity(model):
    arm = load_arm(model)
    assert np.linalg.cond(kinematics.derivatives(arm, home(arm)[None]).jacobian[0]) < 100


def test_joints_with_several_angles_are_refused():
    with pytest.raises(RobotError, match="each joint must have one angle"):
        parse_arm(PLAIN.replace('name="shoulder" type="revolute"', 'name="shoulder" type="floating"'))


@pytest.mark.parametrize(
    "head", ['<!DOCTYPE robot [<!ENTITY a "two">]>', '<?xml version="1.0"?>\n<!doctype robot>', '<!ENTITY a "b">', "\0"]
)
def test_descriptions_with_declarations_are_refused(tmp_path, head):
    """By them a short description can stand for a long one, or for another file."""
    with pytest.raises(RobotError, match=r"robot\.urdf: not XML: (declaration|zero at character 0)"):
        parse_arm(head + PLAIN)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32", "cp037"])
def test_descriptions_in_other_encodings_are_refused(tmp_path, encoding):
    file = tmp_path / "two.urdf"
    file.write_bytes(f'<!DOCTYPE robot [<!ENTITY a "two">]>{PLAIN}'.encode(encoding))
    with pytest.raises(RobotError, match=r"two\.urdf: (cannot be read: not UTF-8|not XML: zero at character 1)"):
        load_arm(file)


def test_comments_stay(tmp_path):
    assert parse_arm(f"<!-- an arm -->{PLAIN}").joints == ("shoulder", "elbow")

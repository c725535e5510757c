"""Moves from rest to rest: limits, rests, derivatives; random motion; programs."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kreisel.errors import RobotError, SettingsError
from kreisel.geometry.kuka import from_abc
from kreisel.robot import excitation, kinematics, program
from kreisel.robot.excitation import random_plan
from kreisel.robot.kinematics import load_arm
from kreisel.robot.motion import Limits, Move, plan
from kreisel.robot.program import EXAMPLE, read_program

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 30.0, 0.0])
TARGETS = np.radians([[60.0, -60.0, 60.0, 40.0, 70.0, -80.0], [-30.0, -100.0, 110.0, -90.0, -40.0, 120.0]])
STEP = 0.001
"""s between the moments at which limits are looked at; 23 rad/s^3 and 3 m change 0.07 m/s^2 in it."""


@pytest.fixture(scope="module")
def arm():
    return load_arm("kr125")


def limits_of(arm, tool_speed=1.5, tool_acceleration=6.0):
    return Limits.of(arm, tool_speed, tool_acceleration)


def two_moves(arm, smoothing=0.012, speed=1.0, **limits):
    moves = [Move(target, 1.0, speed) for target in TARGETS]
    return plan(arm, HOME, 2.0, moves, limits_of(arm, **limits), smoothing)


def moments(one):
    return np.arange(0.0, one.seconds, STEP)


def tool(arm, one, t):
    return kinematics.motion(arm, *one.at(t))


def peaks(arm, one):
    motion = tool(arm, one, moments(one))
    return (np.linalg.norm(x, axis=1).max() for x in (motion.velocities, motion.accelerations))


# Timing


@pytest.mark.parametrize("smoothing", [0.0, 0.012, 0.1])
def test_joints_keep_their_limits(arm, smoothing):
    """A mean over time never exceeds what it is the mean of; 1e-9 for rounding."""
    free = two_moves(arm, smoothing, tool_speed=20.0, tool_acceleration=100.0)
    limits = limits_of(arm)
    q, dq, ddq = free.at(moments(free))
    assert np.all(np.abs(dq) <= limits.velocity * (1.0 + 1e-9))
    assert np.all(np.abs(ddq) <= limits.acceleration * (1.0 + 1e-9))
    # not by standing still: the slowest joint of a move is at its limit, for more than the smoothing lasts
    assert np.max(np.abs(dq) / limits.velocity) > 0.99
    assert np.max(np.abs(np.diff(ddq, axis=0)) / STEP / limits.jerk) < 1.0 + 1e-6
    assert np.all((q >= arm.lower) & (q <= arm.upper))


@pytest.mark.parametrize(
    ("limits", "reached"), [((0.5, 100.0), "speed"), ((20.0, 2.0), "acceleration"), ((1.5, 6.0), "speed")]
)
def test_tool_keeps_its_limits(arm, limits, reached):
    """Within 2 %: the planner looks at forty moments of a move. And it uses them, to 15 %."""
    for one in (
        two_moves(arm, tool_speed=limits[0], tool_acceleration=limits[1]),
        random_plan(np.random.default_rng(3), arm, limits_of(arm, *limits), 60.0),
    ):
        speed, acceleration = peaks(arm, one)
        shares = {"speed": speed / limits[0], "acceleration": acceleration / limits[1]}
        assert max(shares.values()) <= 1.02
        assert shares[reached] > 0.85


def test_slow_moves_are_the_same_slowed_down(arm):
    """Half the speed: twice the time, and a quarter of the acceleration, on the same way."""
    full, half = (two_moves(arm, 0.0, speed, tool_speed=20.0, tool_acceleration=100.0) for speed in (1.0, 0.5))
    for k in range(2):
        (a, b), (c, d) = ((one.standstills[k, 1], one.standstills[k + 1, 0]) for one in (full, half))
        assert d - c == pytest.approx(2.0 * (b - a), rel=1e-9)
        share = np.linspace(0.0, 1.0, 100)
        at_full, at_half = full.at(a + share * (b - a)), half.at(c + share * (d - c))
        for i, factor in enumerate((1.0, 0.5, 0.25)):
            np.testing.assert_allclose(at_half[i], factor * at_full[i], rtol=0, atol=1e-7)


def test_tool_limits_are_shared_too(arm):
    """A move at a share of the speed has that share of the tool's speed, and its square of the acceleration."""
    speed, acceleration = peaks(arm, two_moves(arm, speed=0.4, tool_speed=1.0, tool_acceleration=3.0))
    assert 0.85 * 0.4 < speed <= 0.4 * 1.02
    assert acceleration <= 3.0 * 0.4**2 * 1.02


@pytest.mark.parametrize("smoothing", [0.0, 0.012, 0.1])
def test_rests_are_at_rest(arm, smoothing):
    one = two_moves(arm, smoothing)
    assert one.standstills.shape == (3, 2)
    assert one.standstills[0, 0] == 0.0
    assert np.diff(one.standstills, axis=1).ravel() == pytest.approx([2.0, 1.0, 1.0])
    assert one.seconds == one.standstills[-1, 1]
    for (begin, end), where in zip(one.standstills, (HOME, *TARGETS), strict=True):
        # the interpolator's window reaches half its length into a rest, but not into the first and the last
        t = np.linspace(max(begin + smoothing / 2, 0.0) + 1e-9, end - smoothing / 2 - 1e-9, 50)
        q, dq, ddq = one.at(t)
        np.testing.assert_allclose(q, np.tile(where, (50, 1)), rtol=0, atol=1e-12)
        assert np.all(q == q[0])
        assert not np.any(dq)
        assert not np.any(ddq)


def test_at_rest_is_where_the_joints_stand(arm):
    one = two_moves(arm, 0.0)
    t = moments(one)
    _, dq, _ = one.at(t)
    np.testing.assert_array_equal(one.at_rest(t), np.all(dq == 0.0, axis=1))
    inner = one.at_rest(t, 0.2)
    assert np.all(one.at_rest(t[inner] + 0.199))
    assert np.all(one.at_rest(t[inner] - 0.199))
    assert inner.sum() == pytest.approx(one.at_rest(t).sum() - 4 * 0.2 / STEP, abs=4)


def test_before_and_after_the_arm_stands(arm):
    for smoothing in (0.0, 0.012):
        one = two_moves(arm, smoothing)
        q, dq, ddq = one.at(np.array([-5.0, one.seconds + 5.0]))
        np.testing.assert_allclose(q, [HOME, TARGETS[1]], rtol=0, atol=1e-12)
        assert not np.any(dq)
        assert not np.any(ddq)


@pytest.mark.parametrize("smoothing", [0.0, 0.012, 0.1])
def test_rates_and_accelerations_are_derivatives(arm, smoothing):
    """Central differences over 2 h: off by J h^2 / 6 and J h / 2 where the jerk is at most J.

    Rounding adds 1e-11 rad / h: means are differences of integrals of up to 30 rad s, 7e-15 over 12 ms.
    """
    one = two_moves(arm, smoothing)
    h = 1e-4
    t = np.random.default_rng(0).uniform(h, one.seconds - h, 5000)
    (before, rate_before, _), (_, rate, acceleration), (after, rate_after, _) = (one.at(t + d) for d in (-h, 0.0, h))
    jerk = limits_of(arm).jerk
    assert np.all(np.abs((after - before) / (2 * h) - rate) <= jerk * h**2 / 6 + 1e-11 / h)
    assert np.all(np.abs((rate_after - rate_before) / (2 * h) - acceleration) <= jerk * h / 2 + 1e-10 / h)


@pytest.mark.parametrize("smoothing", [0.012, 0.1])
def test_smoothing_is_the_mean_over_a_window(arm, smoothing):
    """Against twenty-point Gauss quadrature; a corner in the second derivative costs it J w^3 / 20^4."""
    one = two_moves(arm, smoothing)
    rough = replace(one, smoothing=0.0)
    t = np.random.default_rng(1).uniform(0.1, one.seconds - 0.1, 300)
    x, weights = np.polynomial.legendre.leggauss(20)
    mean = sum(w / 2 * rough.at(t + x_k * smoothing / 2)[0] for x_k, w in zip(x, weights, strict=True))
    np.testing.assert_allclose(one.at(t)[0], mean, rtol=0, atol=23.0 * smoothing**3 / 20**4 + 1e-11)
    # and it does something: the mean of q'' s^2 / 2 is q'' w^2 / 24
    expected = np.abs(rough.at(t)[2]).max() * smoothing**2 / 24
    assert np.abs(one.at(t)[0] - rough.at(t)[0]).max() == pytest.approx(expected, rel=0.3)


def test_moves_to_where_the_arm_is_prolong_the_rest(arm):
    limits = limits_of(arm)
    still = plan(arm, HOME, 2.0, [Move(HOME, 1.5)], limits)
    np.testing.assert_allclose(still.standstills, [[0.0, 3.5]])
    assert np.all(still.at(np.linspace(0.0, 3.5, 20))[0] == HOME)
    direct = plan(arm, HOME, 2.0, [Move(TARGETS[0], 2.5)], limits)
    twice = plan(arm, HOME, 1.5, [Move(HOME, 0.5), Move(TARGETS[0], 1.0), Move(TARGETS[0], 1.5)], limits)
    np.testing.assert_allclose(twice.standstills, direct.standstills, rtol=0, atol=1e-9)
    t = moments(direct)
    np.testing.assert_allclose(twice.at(t)[0], direct.at(t)[0], rtol=0, atol=1e-11)


def test_one_joint_alone_may_move(arm):
    target = HOME + np.radians([0, 0, 0, 25.0, 0, 0])
    one = plan(arm, HOME, 1.0, [Move(target, 1.0)], limits_of(arm))
    q, _, _ = one.at(moments(one))
    np.testing.assert_allclose(np.ptp(q, axis=0)[[0, 1, 2, 4, 5]], 0.0, atol=1e-12)
    assert np.ptp(q[:, 3]) == pytest.approx(np.radians(25.0), abs=1e-9)


def test_a_rest_outlasts_the_smoothing(arm):
    """Else the arm would never stand."""
    one = plan(arm, HOME, 1.0, [Move(target, 0.0) for target in TARGETS], limits_of(arm), 0.1)
    assert np.all(np.diff(one.standstills, axis=1) >= 0.1 - 1e-12)
    _, dq, _ = one.at(one.standstills[1:].mean(axis=1))
    np.testing.assert_allclose(dq, 0.0, atol=1e-12)


def test_targets_beyond_a_range_are_named(arm):
    bad = TARGETS[1] + np.radians([0, 110.0, 0, 0, 0, 0])
    with pytest.raises(RobotError, match=r"move 2: joint_2 at 10\.00 deg is beyond its range, -130\.0 to 3\.0 deg"):
        plan(arm, HOME, 1.0, [Move(TARGETS[0], 1.0), Move(bad, 1.0)], limits_of(arm))
    with pytest.raises(RobotError, match="joint_2"):
        plan(arm, bad, 1.0, [Move(TARGETS[0], 1.0)], limits_of(arm))


def test_without_ruckig_the_message_says_how_to_get_it(arm, monkeypatch):
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(RobotError, match="ruckig: pip install ruckig"):
        two_moves(arm)


# Random motion


@pytest.mark.parametrize("model", ["kr125", "ur10e"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_motion_shows_all_six_sensors(model, seed):
    """In a minute: each axis turns by more than 10 deg/s (rms, on the move), and feels most of gravity's range."""
    arm = load_arm(model)
    one = random_plan(np.random.default_rng(seed), arm, limits_of(arm), 60.0)
    assert one.seconds >= 60.0
    t = np.arange(0.0, 60.0, 0.005)
    motion = tool(arm, one, t)
    rms = np.sqrt(np.mean(motion.rates[~one.at_rest(t)] ** 2, axis=0))
    assert np.all(np.degrees(rms) > 10.0)
    up = Rotation.from_quat(motion.quaternions, scalar_first=True).as_matrix()[:, 2, :]  # the base's z in the tool
    assert np.all(np.ptp(up, axis=0) > 1.0)  # of 2
    # between any two rests something turns, and gravity moves
    for (_, begin), (end, _) in zip(one.standstills[:-1], one.standstills[1:], strict=True):
        moving = (t > begin) & (t < end)
        if np.any(moving):
            assert np.degrees(np.sqrt(np.mean(motion.rates[moving] ** 2, axis=0)).max()) > 10.0
            assert np.ptp(up[moving], axis=0).max() > 0.1


@pytest.mark.parametrize("model", ["kr125", "ur10e"])
def test_random_motion_keeps_ranges_and_rests(model):
    arm = load_arm(model)
    share, rest = 0.4, 0.8
    one = random_plan(
        np.random.default_rng(5), arm, limits_of(arm), 80.0, rest=rest, first_rest=3.0, range_share=share, smoothing=0.0
    )
    lower, upper = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    middle, half = (lower + upper) / 2, share * (upper - lower) / 2
    q, _, _ = one.at(moments(one))
    assert np.all(np.abs(q - middle) <= half + 1e-9)
    lengths = np.diff(one.standstills, axis=1).ravel()
    assert lengths[0] == pytest.approx(3.0)
    assert np.all((lengths[1:] >= 0.8 * rest - 1e-9) & (lengths[1:] <= 1.2 * rest + 1e-9))
    assert lengths.size > 8
    stops, _ = kinematics.poses(arm, one.at(one.standstills[1:].mean(axis=1))[0])
    far = np.linalg.norm(stops, axis=1)
    assert np.all(stops[:, 2] > 0.1 * far)  # above the floor
    assert np.all(np.hypot(stops[:, 0], stops[:, 1]) > 0.3 * far)  # beside the base


def test_random_motion_follows_from_the_generator(arm):
    def angles(seed):
        one = random_plan(np.random.default_rng(seed), arm, limits_of(arm), 30.0)
        return one.at(np.linspace(0.0, 30.0, 200))[0]

    np.testing.assert_array_equal(angles(1), angles(1))
    assert np.abs(angles(1) - angles(2)).max() > 0.1


def test_recordings_too_short_for_a_move_are_refused(arm):
    with pytest.raises(RobotError, match="a single move takes .* s, longer than the recording of 10 s"):
        random_plan(np.random.default_rng(0), arm, limits_of(arm, tool_speed=0.01), 10.0)


def test_home_is_inside_the_ranges():
    for model in kinematics.MODELS:
        arm = load_arm(model)
        kinematics.check_range(arm, excitation.home(arm))


# Programs


@pytest.fixture
def written(tmp_path, arm):
    def read(text):
        file = tmp_path / "moves.toml"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_program(file, arm)

    return read


def test_the_example_runs(arm, written):
    found = written(EXAMPLE)
    np.testing.assert_allclose(np.degrees(found.start), [0, -90, 90, 0, 30, 0], atol=1e-9)
    first, second = found.moves
    np.testing.assert_allclose(np.degrees(first.target), [30, -70, 80, 20, 50, 40], atol=1e-9)
    assert (first.rest, first.speed, second.rest, second.speed) == (1.5, 0.8, 2.0, 1.0)
    p, q = kinematics.poses(arm, second.target[None])
    np.testing.assert_allclose(p[0], [1.5, 0.4, 1.6], rtol=0, atol=1e-9)
    turn = Rotation.from_euler("ZYX", [20, 70, 10], degrees=True)
    assert (turn.inv() * Rotation.from_quat(q[0], scalar_first=True)).magnitude() < 1e-9
    one = plan(arm, found.start, 4.0, found.moves, limits_of(arm))
    q_end = one.at(np.array([one.seconds]))[0]
    np.testing.assert_allclose(q_end[0], second.target, rtol=0, atol=1e-9)


def test_abc_are_turns_about_z_y_x():
    """R = Rz(A) Ry(B) Rx(C)."""
    for abc in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 3)):
        ours = Rotation.from_quat(from_abc(*abc), scalar_first=True)
        assert (Rotation.from_euler("ZYX", abc).inv() * ours).magnitude() < 1e-14


def test_defaults_of_a_move(arm, written):
    found = written("[[move]]\njoints_deg = [10, -90, 90, 0, 30, 0]\n")
    np.testing.assert_array_equal(found.start, excitation.home(arm))
    assert (found.moves[0].rest, found.moves[0].speed) == (1.5, 1.0)


def test_a_mark_of_encoding_does_no_harm(written):
    assert len(written(b"\xef\xbb\xbf" + EXAMPLE.encode()).moves) == 2


MOVE = "[[move]]\njoints_deg = [0, -90, 90, 0, 30, 0]\n"


@pytest.mark.parametrize(
    ("text", "kind", "telling"),
    [
        (
            "[[move]]\nposition = [5, 0, 1]\nabc_deg = [0, 0, 0]\n",
            RobotError,
            "move 1: out of reach: the arm comes no nearer",
        ),
        (
            f"{MOVE}[[move]]\njoints_deg = [0, 10, 90, 0, 30, 0]\n",
            RobotError,
            "move 2: joint_2 at 10.00 deg is beyond its range, -130.0 to 3.0 deg",
        ),
        (
            f"start_deg = [0, -90, 90, 0, 130, 0]\n{MOVE}",
            RobotError,
            "start_deg: joint_5 at 130.00 deg is beyond its range, -120.0 to 120.0 deg",
        ),
        (f"speed = 1\n{MOVE}", SettingsError, "unknown key 'speed'; known are: move, start_deg"),
        (
            f"{MOVE}sped = 1\n",
            SettingsError,
            "move 1: unknown key 'sped'; known are: abc_deg, joints_deg, position, rest, speed",
        ),
        ("", SettingsError, "no moves; write at least one [[move]]"),
        ("move = []\n", SettingsError, "no moves"),
        ("move = 5\n", SettingsError, "no moves"),
        ("move = [5]\n", SettingsError, "move 1: expected a table: write [[move]]"),
        ("[move]\njoints_deg = [0, -90, 90, 0, 30, 0]\n", SettingsError, "at least one [[move]]"),
        ("[[move]]\nrest = 1\n", SettingsError, "move 1: expected joints_deg, or position with abc_deg"),
        ("[[move]]\nposition = [1.5, 0.4, 1.6]\n", SettingsError, "position with abc_deg"),
        ("[[move]]\nabc_deg = [0, 0, 0]\n", SettingsError, "position with abc_deg"),
        ("[[move]]\nposition = [1, 2]\nabc_deg = [0, 0, 0]\n", SettingsError, "position: [1, 2]; expected 3 numbers"),
        ("[[move]]\njoints_deg = [0, 0]\n", SettingsError, "joints_deg: [0, 0]; expected 6 numbers in brackets"),
        ("[[move]]\njoints_deg = 5\n", SettingsError, "joints_deg: 5; expected 6 numbers"),
        ('[[move]]\njoints_deg = [0, 0, 0, 0, 0, "a"]\n', SettingsError, "joints_deg: 'a' is not a number"),
        ("[[move]]\njoints_deg = [0, 0, 0, 0, 0, nan]\n", SettingsError, "nan is not a number"),
        ("[[move]]\njoints_deg = [0, 0, 0, 0, 0, true]\n", SettingsError, "True is not a number"),
        (f"start_deg = 5\n{MOVE}", SettingsError, "start_deg: 5; expected 6 numbers"),
        (f'{MOVE}rest = "long"\n', SettingsError, "move 1: rest: 'long' is not a number"),
        (f"{MOVE}rest = -1\n", SettingsError, "rest -1 s, speed 1; expected 0 to 3600 s, and 0.01 to 1"),
        (f"{MOVE}speed = 0\n", SettingsError, "expected 0 to 3600 s, and 0.01 to 1"),
        (f"{MOVE}speed = 1.5\n", SettingsError, "expected 0 to 3600 s, and 0.01 to 1"),
        ("move = [\n", SettingsError, "not valid TOML"),
        (b"\xff\xfe", SettingsError, "not UTF-8 text"),
    ],
)
def test_what_is_wrong_with_a_program_stands_in_one_line(written, text, kind, telling):
    with pytest.raises(kind) as caught:
        written(text)
    message = str(caught.value)
    assert telling in message
    assert "moves.toml: " in message
    assert "\n" not in message


def test_a_pose_beyond_a_joints_range_is_named(arm, written):
    """The pose of joint 5 at 125 deg; the wrist turned over would stand at -125 deg."""
    p, q = kinematics.poses(arm, np.radians([[0.0, -90.0, 90.0, 0.0, 125.0, 0.0]]))
    abc = Rotation.from_quat(q[0], scalar_first=True).as_euler("ZYX", degrees=True)
    pose = f"[[move]]\nposition = {p[0].tolist()}\nabc_deg = {abc.tolist()}\n"
    with pytest.raises(RobotError, match=r"move 1: joint_5 at 125\.00 deg .* -120\.0 to 120\.0 deg"):
        written(f"start_deg = [0, -90, 90, 0, 110, 0]\n{pose}")


def test_a_program_that_is_not_there(tmp_path, arm):
    with pytest.raises(SettingsError, match=r"none\.toml: cannot be read: No such file"):
        program.read_program(tmp_path / "none.toml", arm)

"""Each error of the simulated arm alone: as large as asked for, and where it belongs."""

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.spatial.transform import Rotation

from kreisel.robot import kinematics
from kreisel.robot.kinematics import load_arm
from kreisel.simulation.cell_settings import Errors
from kreisel.simulation.controller import draw_errors

from ..felt import LEVEL, MARGIN, H, agreement, central, felt, inside_chi_square, local_site, rests_of, run

# Errors of the arm, each alone


def pose_errors(one, other):
    """Position in r and rotation as right perturbation that lead from one recording's poses to the other's, (n, 6)."""
    a, b = one.reference, other.reference
    np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
    turned = Rotation.from_quat(a.quaternions, scalar_first=True).inv()
    turned = turned * Rotation.from_quat(b.quaternions, scalar_first=True)
    return np.hstack([b.positions - a.positions, turned.as_rotvec()])


EVERY = {"interval": 0.012}
"""s, as the paper's controller records."""


@pytest.fixture(scope="module")
def plain():
    """Four minutes of poses as they should be."""
    return run(240.0, imu={"rate": 50.0}, reference=EVERY)[1]


def with_errors(errors, seconds=240.0, **reference):
    return run(seconds, errors=errors, imu={"rate": 50.0}, reference={**EVERY, **reference})


def test_faultless_poses_are_those_of_the_joints(plain):
    p, q = kinematics.poses(load_arm("kr125"), plain.joints.angles)
    np.testing.assert_array_equal(plain.reference.positions, p)
    np.testing.assert_allclose(plain.reference.quaternions, q, rtol=0, atol=1e-15)


def test_repeatability_is_one_draw_for_each_rest(plain):
    _, other = with_errors({"repeatability_position_sd": 1e-3, "repeatability_orientation_sd": 5e-4})
    errors = pose_errors(plain, other)
    rests = rests_of(plain.joints.angles)
    assert len(rests) > 20
    draws = []
    for rest in rests:
        # rotation vectors from quaternions are good to 1e-15
        np.testing.assert_allclose(errors[rest], np.tile(errors[rest][0], (rest.sum(), 1)), rtol=0, atol=1e-14)
        draws.append(errors[rest][0])
    draws = np.array(draws)
    assert inside_chi_square(draws[:, :3], 1e-3)
    assert inside_chi_square(draws[:, 3:], 5e-4)
    # between two rests it passes from one to the other, nowhere beyond, nowhere in a jump
    for before, after, a, b in zip(rests[:-1], rests[1:], draws[:-1], draws[1:], strict=True):
        between = slice(np.flatnonzero(before)[-1], np.flatnonzero(after)[0] + 1)
        low, high = np.minimum(a, b), np.maximum(a, b)
        assert np.all((errors[between] >= low - 1e-14) & (errors[between] <= high + 1e-14))
        moves = between.stop - between.start
        # the steepest of a fifth-order passage is 15/8 of its mean
        assert np.all(np.abs(np.diff(errors[between], axis=0)) <= 2.0 * np.abs(b - a) / (moves - 3) + 1e-14)
    np.testing.assert_array_equal(other.joints.angles, plain.joints.angles)


def speeds(recording):
    return np.linalg.norm(np.gradient(recording.reference.positions, 0.012, axis=0), axis=1)


def test_path_error_is_there_on_the_move_alone(plain):
    """Half of it at 50 mm/s; its variance is known to 1 / sqrt(T / tau) of T / tau independent squares."""
    tau = 0.15
    sizes = {"path_position_sd": 1e-3, "path_orientation_sd": 5e-4}
    _, other = with_errors({**sizes, "path_correlation_time": tau})
    errors = pose_errors(plain, other)
    for rest in rests_of(plain.joints.angles):
        assert np.abs(errors[rest]).max() < 1e-14
    speed = speeds(plain)
    fast = speed > 0.2
    process = errors * (1.0 + 0.01 / np.maximum(speed, 0.01))[:, None] / np.repeat([1e-3, 5e-4], 3)
    independent = 3 * 0.012 * fast.sum() / tau
    for part in (slice(0, 3), slice(3, 6)):
        assert np.mean(process[fast][:, part] ** 2) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / independent))
    for lag in (3, 6, 12, 25):
        both = fast[lag:] & fast[:-lag]
        for part in (slice(0, 3), slice(3, 6)):
            found = np.mean(process[lag:][both][:, part] * process[:-lag][both][:, part])
            assert found == pytest.approx(np.exp(-lag * 0.012 / tau), abs=4.0 * np.sqrt(2.0 / independent))
    np.testing.assert_array_equal(other.joints.angles, plain.joints.angles)


def test_path_error_may_be_new_for_each_pose(plain):
    _, other = with_errors({"path_position_sd": 1e-3, "path_correlation_time": 0.0})
    speed = speeds(plain)
    fast = speed > 0.2
    process = pose_errors(plain, other)[:, :3] * (1.0 + 0.01 / np.maximum(speed, 0.01))[:, None] / 1e-3
    assert inside_chi_square(process[fast], 1.0)
    both = fast[1:] & fast[:-1]
    correlation = np.mean(process[1:][both] * process[:-1][both])
    assert abs(correlation) < 4.0 / np.sqrt(3 * both.sum())


def test_geometry_is_seen_by_the_imu_and_not_by_the_controller():
    """Reported poses stay those of the nominal arm at the same angles; the IMU feels the arm as it is."""
    size = 3e-3
    _, plain = run(site=LEVEL)
    truth, other = run(errors={"geometry_length_sd": size, "geometry_angle_sd": size}, site=LEVEL)
    np.testing.assert_array_equal(other.joints.angles, plain.joints.angles)
    np.testing.assert_array_equal(other.reference.positions, plain.reference.positions)
    p, q = kinematics.poses(truth.actual, other.joints.angles)
    agreement(truth, other, p, q, *local_site())
    # six joints and the tool, each 3 mm and 3 mrad at up to 2.6 m: some 10 mm
    error = np.linalg.norm(p - other.reference.positions, axis=1)
    assert 1e-3 < np.sqrt(np.mean(error**2)) < 0.05
    # and to first order it is what the regressor says; to second, (7 * 3 mrad)^2 of 2.6 m
    some = slice(0, len(p), 500)
    J = kinematics.derivatives(load_arm("kr125"), other.joints.angles[some]).regressor
    first_order = J[:, :3] @ truth.arm.placement.ravel()
    np.testing.assert_allclose((p - other.reference.positions)[some], first_order, rtol=0, atol=(7 * size) ** 2 * 2.6)


def test_arms_differ_as_their_errors_say():
    rng, arm = np.random.default_rng(0), load_arm("kr125")
    errors = Errors(
        geometry_length_sd=1e-3, geometry_angle_sd=2e-3, gear_eccentricity_sd=3e-4, servo_lag=0.02, sag_sd=1e-3
    )
    arms = [draw_errors(rng, arm, errors) for _ in range(60)]
    placement = np.array([a.placement for a in arms])
    assert placement.shape == (60, 7, 6)
    assert inside_chi_square(placement[..., :3], 1e-3)
    assert inside_chi_square(placement[..., 3:], 2e-3)
    assert inside_chi_square([a.eccentricity for a in arms], 3e-4)
    phases = np.array([a.phase for a in arms])
    # uniform: the mean of 360 unit vectors has length 1 / sqrt(360)
    assert np.abs(np.exp(1j * phases).mean()) < 4.0 / np.sqrt(phases.size)
    lags = np.array([a.lag for a in arms]) / 0.02
    assert np.all((lags >= 0.7) & (lags <= 1.3))
    assert lags.std() == pytest.approx(0.6 / np.sqrt(12.0), rel=0.2)
    # the sag at the largest torque anywhere in the ranges; two hundred poses find it to some per cent
    angles = rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (3000, 6))
    largest = np.abs(kinematics.gravity_torques(arm, angles)).max(axis=0)
    sag = np.array([a.compliance for a in arms])[:, 1:] * largest[1:]
    assert inside_chi_square(sag / 1.05, 1e-3)
    assert not np.any([a.compliance[0] for a in arms])  # the first axis is upright


def test_gears_err_once_a_turn(plain):
    """Angles reported are short of the joint's by amplitude * sin(angle + phase), and poses go with them."""
    truth, other = with_errors({"gear_eccentricity_sd": 1e-3})
    expected = -truth.arm.eccentricity * np.sin(plain.joints.angles + truth.arm.phase)
    np.testing.assert_allclose(other.joints.angles - plain.joints.angles, expected, rtol=0, atol=1e-14)
    p, _ = kinematics.poses(load_arm("kr125"), other.joints.angles)
    np.testing.assert_array_equal(other.reference.positions, p)
    np.testing.assert_array_equal(other.imu.rates, plain.imu.rates)
    assert np.abs(truth.arm.eccentricity).min() > 0.0


def test_sag_follows_the_gravity_torque(plain):
    """A motor stands beyond its joint by compliance times the torque that holds the arm up."""
    truth, other = with_errors({"sag_sd": 1e-3})
    some = slice(0, None, 100)
    torques = kinematics.gravity_torques(load_arm("kr125"), plain.joints.angles[some])
    beyond = (other.joints.angles - plain.joints.angles)[some]
    np.testing.assert_allclose(beyond, truth.arm.compliance * torques, rtol=0, atol=1e-14)
    assert np.abs(beyond[:, 1]).max() > 1e-5
    np.testing.assert_array_equal(other.imu.accelerations, plain.imu.accelerations)


def test_servo_lag_puts_reports_ahead_of_the_motion():
    """Each joint by its own lag; central differences over 5 ms miss 58 rad/s^3 H^2 / 6, times the lag."""
    lag = 0.02
    _, plain = run()
    truth, other = run(errors={"servo_lag": lag})
    assert np.all((truth.arm.lag >= 0.7 * lag) & (truth.arm.lag <= 1.3 * lag))
    rates = np.gradient(plain.joints.angles, H, axis=0)[1:-1]
    ahead = (other.joints.angles - plain.joints.angles)[1:-1]
    np.testing.assert_allclose(ahead, truth.arm.lag * rates, rtol=0, atol=1.3 * lag * 58.0 * H**2 / 6.0 + 1e-9)
    assert np.abs(ahead).max() > 0.5 * lag
    # the tool: displaced along its way, by about the lag
    velocity = np.gradient(plain.reference.positions, H, axis=0)
    displaced = other.reference.positions - plain.reference.positions
    along = np.sum(displaced * velocity) / np.sum(velocity**2)
    assert 0.7 * lag < along < 1.3 * lag
    across = displaced - along * velocity
    assert np.sum(across**2) < 0.15 * np.sum(displaced**2)  # lags differ by 30 %, their squares by a tenth


def test_oscillation_after_a_stop():
    """A rest's gyro readings: one frequency, one decay.

    Their swing is linear but for the pose's own change by it, which is as many thousandths as it has milliradians.
    """
    frequency, damping, stride = 8.0, 0.03, 5
    _, recording = run(
        30.0, errors={"oscillation_frequency": frequency, "oscillation_damping": damping}, motion={"rest": 2.5}
    )
    stops = [np.flatnonzero(rest) for rest in rests_of(recording.joints.angles)][1:]
    offset = round(MARGIN / H)  # of the first pose
    rows, right, sizes = [], [], []
    for rest in stops:
        w = recording.imu.rates[rest[10] + offset : rest[-1] + offset + 1 : stride]
        w = w - w[-8:].mean(axis=0)
        sizes.append(np.abs(w[: len(w) // 3]).max() / np.abs(w[-len(w) // 3 :]).max())
        for axis in range(3):
            rows.append(np.column_stack([w[1:-1, axis], w[:-2, axis], np.ones(len(w) - 2)]))
            right.append(w[2:, axis])
    # w_k+1 = 2 d cos(angle) w_k - d^2 w_k-1 + constant
    blocks = np.zeros((sum(map(len, rows)), 2 + len(rows)))
    k = 0
    for i, block in enumerate(rows):
        blocks[k : k + len(block), :2], blocks[k : k + len(block), 2 + i] = block[:, :2], 1.0
        k += len(block)
    (a, b, *_), *_ = np.linalg.lstsq(blocks, np.concatenate(right), rcond=None)
    decay, step = np.sqrt(-b), stride * H
    natural = 2.0 * np.pi * frequency
    assert -np.log(decay) / step == pytest.approx(damping * natural, rel=0.02)
    angle = np.arccos(a / (2.0 * decay))
    assert angle / step == pytest.approx(natural * np.sqrt(1.0 - damping**2), rel=2e-3)
    assert min(sizes) > 3.0  # it dies away


def test_oscillation_is_a_damped_spring_at_each_joint():
    """Against SciPy's simulation of the spring, driven by the reported angles' own second derivative.

    At corners the differentiated angles err by H^2 / 12 of a fourth derivative of 58 / 0.012 rad/s^4, 2.5e-3 rad/s^2,
    for three samples: 2e-5 rad/s. The swing reaches some 50 mrad/s.
    """
    frequency, damping = 5.0, 0.05
    errors = {"oscillation_frequency": frequency, "oscillation_damping": damping}
    _, recording = run(errors=errors, site=LEVEL, imu={"errors": False, "lever_arm_spread": 0.0})
    _, stiff = run(site=LEVEL, imu={"errors": False, "lever_arm_spread": 0.0})
    np.testing.assert_array_equal(recording.reference.positions, stiff.reference.positions)
    motors = recording.joints.angles
    drive = central(motors, 2, 4)
    omega = 2.0 * np.pi * frequency
    t = np.arange(len(drive)) * H
    swing = np.column_stack([lsim(([-1.0], [1.0, 2.0 * damping * omega, omega**2]), u, t)[1] for u in drive.T])
    p, q = kinematics.poses(load_arm("kr125"), motors[4:-4] + swing)
    rates, _, _ = felt(p, q, *local_site(), 4)
    first = round(MARGIN / H) + 8
    found = recording.imu.rates[first : first + len(rates)]
    assert np.abs(found - rates).max() < 2e-5
    without = stiff.imu.rates[first : first + len(rates)]
    assert np.abs(found - without).max() > 0.02  # and it is there


def test_encoders_have_steps(plain):
    step = 1e-3
    _, other = with_errors({"encoder_step": step})
    counts = other.joints.angles / step
    np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-9)
    error = other.joints.angles - plain.joints.angles
    assert np.abs(error).max() <= step / 2 + 1e-12
    moving = np.abs(np.gradient(plain.joints.angles, axis=0)) > step
    # uniform where several steps pass between two poses; its square has the relative deviation sqrt(4 / 5)
    assert np.mean(error[moving] ** 2) == pytest.approx(step**2 / 12, rel=4.0 * np.sqrt(0.8 / moving.sum()))
    p, _ = kinematics.poses(load_arm("kr125"), other.joints.angles)
    np.testing.assert_array_equal(other.reference.positions, p)


def test_poses_are_taken_beside_their_stamps(plain):
    """By a time that is the same for all joints; n draws show their deviation to 1 / sqrt(2 n).

    Where joints turn at more than 0.3 rad/s, an acceleration of 3 rad/s^2 changes the quotient by 0.3 %.
    """
    jitter = 5e-4
    _, other = with_errors({}, jitter=jitter)
    np.testing.assert_array_equal(other.reference.stamps_ns, plain.reference.stamps_ns)
    moved = other.joints.angles - plain.joints.angles
    rates = np.gradient(plain.joints.angles, 0.012, axis=0)
    size = np.sum(rates**2, axis=1)
    fast = size > 0.3**2
    late = np.sum(moved * rates, axis=1)[fast] / size[fast]
    assert np.sqrt(np.mean(late**2)) == pytest.approx(jitter, rel=4.0 / np.sqrt(2.0 * late.size) + 0.01)
    assert abs(late.mean()) < 4.0 * jitter / np.sqrt(late.size)
    assert np.sqrt(np.mean((moved[fast] - late[:, None] * rates[fast]) ** 2)) < 0.02 * np.sqrt(
        np.mean(moved[fast] ** 2)
    )
    for rest in rests_of(plain.joints.angles):
        inside = np.flatnonzero(rest)[1:-1]
        assert not np.any(moved[inside])


def test_poses_and_samples_are_lost(plain):
    share = 0.25
    _, other = run(240.0, imu={"rate": 50.0, "drop_share": share}, reference={**EVERY, "drop_share": share})
    for whole, part in (
        (plain.reference.stamps_ns, other.reference.stamps_ns),
        (plain.imu.stamps_ns, other.imu.stamps_ns),
    ):
        assert np.all(np.isin(part, whole))
        assert (part[0], part[-1]) == (whole[0], whole[-1])
        lost = 1.0 - part.size / whole.size
        assert lost == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / whole.size))
    kept = np.isin(plain.imu.stamps_ns, other.imu.stamps_ns)
    np.testing.assert_array_equal(other.imu.rates, plain.imu.rates[kept])
    kept = np.isin(plain.reference.stamps_ns, other.reference.stamps_ns)
    np.testing.assert_array_equal(other.reference.positions, plain.reference.positions[kept])
    np.testing.assert_array_equal(other.joints.stamps_ns, other.reference.stamps_ns)


def test_what_is_measured_is_what_is_written(plain):
    def short(**reference):
        return run(10.0, reference={**EVERY, **reference})[1]

    assert short(measures="position").reference.quaternions is None
    assert short(measures="orientation").reference.positions is None
    assert short(joints=False).joints is None
    mocap = short(kind="mocap")
    assert mocap.joints is None
    assert mocap.urdf is None
    assert (mocap.settings.reference.kind, mocap.settings.robot.urdf) == ("mocap", None)
    assert plain.urdf == load_arm("kr125").urdf
    assert (plain.settings.robot.urdf, plain.settings.robot.tcp) == ("robot.urdf", "tool0")

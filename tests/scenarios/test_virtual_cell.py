"""The virtual cell against its own poses, by a route that shares no code with it; and each of its errors alone.

Simulator and estimator must not share an error of sign or order. What an IMU should feel is therefore formed here
from nothing but the reported poses: differentiated numerically, with gravity, Earth rate and the sensor model
written out anew in plain NumPy.
"""

import json
import subprocess
import sys
import tomllib
from math import factorial
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import kreisel
from kreisel.errors import RobotError, SettingsError
from kreisel.inertial.noise import GRADES
from kreisel.robot import kinematics
from kreisel.robot.kinematics import load_arm
from kreisel.robot.program import EXAMPLE
from kreisel.simulation import Cell, example, read_cell, simulate
from kreisel.simulation.robot import draw_errors
from kreisel.simulation.settings import Errors

H = 0.0025
"""s between two IMU samples, and between two poses where they are differentiated."""

START_NS = 10**12
MARGIN = 0.06

FAULTLESS = {
    "geometry_length_sd": 0.0,
    "geometry_angle_sd": 0.0,
    "repeatability_position_sd": 0.0,
    "repeatability_orientation_sd": 0.0,
    "path_position_sd": 0.0,
    "path_orientation_sd": 0.0,
}


def run(seconds=30.0, seed=1, errors=None, trial=None, **tables):
    """Truth and recording of a cell without errors or noise, on one clock, but for what is said."""
    content = {
        "seed": seed,
        "seconds": seconds,
        "errors": {**FAULTLESS, **(errors or {})},
        "imu": {"noise": False, "rate": 1.0 / H, **tables.pop("imu", {})},
        "reference": {"interval": H, "clock_offset": 0.0, **tables.pop("reference", {})},
        **tables,
    }
    return simulate(Cell.model_validate(content), Path("cell"), trial=trial)


@pytest.fixture(scope="module")
def faultless():
    return run()


def inside_chi_square(values, sd):
    """Whether the values' root mean square is one that a normal variable of this deviation shows, but for 1e-6."""
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], np.size(values))
    return low < np.sum(np.square(values)) / sd**2 < high


# What an IMU on these poses should feel


def central(x, order, accuracy):
    """Central differences of rows H apart, without the first and last four rows."""
    half = accuracy // 2
    steps = np.arange(-half, half + 1)
    right = np.zeros(accuracy + 1)
    right[order] = factorial(order)
    weights = np.linalg.solve(np.vander(steps, increasing=True).T.astype(float), right) / H**order
    return sum(w * x[4 + k : len(x) - 4 + k] for k, w in zip(steps, weights, strict=True))


def product(a, b):
    """Hamilton's, scalar first."""
    scalar = a[:, 0] * b[:, 0] - np.sum(a[:, 1:] * b[:, 1:], axis=1)
    return np.column_stack([scalar, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])


def felt(p, q, gravity, earth, accuracy):
    """Inertial rate, its derivative and specific force in b, from poses alone."""
    flips = np.cumsum(np.concatenate([[0], np.sum(q[1:] * q[:-1], axis=1) < 0.0]))
    q = np.where(flips % 2, -1.0, 1.0)[:, None] * q
    middle = q[4:-4]
    back = middle * [1.0, -1.0, -1.0, -1.0]
    C_rb = Rotation.from_quat(middle, scalar_first=True).as_matrix()
    # q' = q omega / 2, so omega = 2 q* q', and alpha = 2 q* q'' but for a scalar
    omega_rb = 2.0 * product(back, central(q, 1, accuracy))[:, 1:]
    alpha_rb = 2.0 * product(back, central(q, 2, accuracy))[:, 1:]
    earth_b = np.einsum("nji,j->ni", C_rb, earth)
    acceleration = central(p, 2, accuracy) - gravity + 2.0 * np.cross(earth, central(p, 1, accuracy))
    # the Earth's rate stands still in r, and turns backwards in b
    return omega_rb + earth_b, alpha_rb - np.cross(omega_rb, earth_b), np.einsum("nji,nj->ni", C_rb, acceleration)


def corrected(rates, accelerations, omega, alpha, sensors):
    """Equations (1) and (2), measured to true: omega = K (w' + k), f = K_a (a' + k_a - e), one axis at a time."""
    w, a = rates.copy(), accelerations.copy()
    for power, (k_w, k_a) in enumerate(zip(sensors.k_w, sensors.k_a, strict=True), start=1):
        w += k_w * (rates**power if power > 1 else 1.0)
        a += k_a * (accelerations**power if power > 1 else 1.0)
    axes = np.linalg.inv(sensors.K_a)
    for j, r in enumerate(sensors.lever_arms):
        a[:, j] -= (np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))) @ axes[j]
    return np.array([sensors.K_omega @ row for row in w]), np.array([sensors.K_a @ row for row in a])


def local_site(latitude_deg=49.2571, height=200.0, heading_deg=30.0):
    """Gravity and Earth rate where x points along the heading and z up, from textbook formulae.

    Somigliana's gravity of WGS 84 with the usual free-air reduction, which is good to 1e-7 m/s^2 at 200 m.
    """
    latitude, heading = np.radians([latitude_deg, heading_deg])
    s2 = np.sin(latitude) ** 2
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - 0.00669437999014 * s2)
    g = surface - (3.0877e-6 - 0.0044e-6 * s2) * height + 0.072e-12 * height**2
    north = np.array([np.cos(heading), np.sin(heading), 0.0])  # y points to the left of the heading
    up = np.array([0.0, 0.0, 1.0])
    return -g * up, 7.292115e-5 * (np.cos(latitude) * north + np.sin(latitude) * up)


SMOOTH_RATE, SMOOTH_FORCE = 5e-9, 5e-6
"""rad/s and m/s^2. Joint angles carry rounding of 1e-12 rad, by the smoothing, six of them at up to 2.6 m; sixth
order multiplies that by 1.8 / H and 6 / H^2. Earth's rate is 7e-5 rad/s, its Coriolis term 2e-4 m/s^2."""

CORNER_RATE, CORNER_FORCE = 1e-5, 1e-2
"""Where the jerk turns: joints of at most 23 to 58 rad/s^3 together move the tool by 150 m/s^3, within 12 ms. The
fourth derivative then jumps by 12 500 m/s^4 (less than 2e4 rad/s^4): H^2 / 12 and H^3 / 24 of it, twice."""


def agreement(truth, recording, p, q, gravity, earth):
    """Compare readings with what the poses p, q (at the reference's stamps) make an IMU feel.

    Where fourth and sixth order agree, differentiation is good, and readings must fit to its rounding; elsewhere
    to what a jump of the fourth derivative does.
    """
    first = np.searchsorted(recording.imu.stamps_ns, recording.reference.stamps_ns[0])
    rows = slice(first, first + len(p))
    np.testing.assert_array_equal(recording.imu.stamps_ns[rows], recording.reference.stamps_ns)
    coarse, fine = (felt(p, q, gravity, earth, accuracy) for accuracy in (4, 6))
    omega, alpha, force = fine
    inner = (recording.imu.rates[rows][4:-4], recording.imu.accelerations[rows][4:-4])
    found_omega, found_force = corrected(*inner, omega, alpha, truth.sensors)
    # in shares of what is allowed; an accelerometer is 0.4 m off at the most
    by_rate = np.abs(coarse[0] - omega).max(axis=1) / SMOOTH_RATE
    by_force = (np.abs(coarse[2] - force).max(axis=1) + 0.4 * np.abs(coarse[1] - alpha).max(axis=1)) / SMOOTH_FORCE
    unsure = np.maximum(by_rate, by_force)
    # a jump shows in both orders only when both stencils hold it: look three rows to each side
    smooth = np.max([np.roll(unsure, k) for k in range(-3, 4)], axis=0) < 0.5
    rate_error = np.abs(found_omega - omega).max(axis=1)
    force_error = np.abs(found_force - force).max(axis=1)
    assert rate_error[smooth].max() < SMOOTH_RATE
    assert force_error[smooth].max() < SMOOTH_FORCE
    assert rate_error.max() < CORNER_RATE
    assert force_error.max() < CORNER_FORCE
    moving = np.linalg.norm(omega, axis=1) > 0.1
    assert moving.mean() > 0.4  # there is something to feel
    assert smooth[moving].mean() > 0.5  # and most of it is looked at closely
    assert np.all(np.abs(omega).max(axis=0) > 0.3)
    assert np.ptp(np.linalg.norm(force, axis=1)) > 1.0


LEVEL = {"tilt_sd": 1e-13}

DEVICES = {
    "as it comes": {},
    "turned, bent and far off": {
        "grade": "consumer-mems",
        "mounting_deg": (110.0, -60.0, 75.0),
        "lever_arm": (0.3, -0.2, 0.15),
        "lever_arm_spread": 0.05,
        "quadratic_gyro_sd": 5e-3,
        "quadratic_accel_sd": 5e-4,
    },
    "faultless at the tool": {"errors": False, "lever_arm": (0.0, 0.0, 0.0)},
}


@pytest.mark.parametrize("device", list(DEVICES))
def test_readings_are_what_the_poses_make_an_imu_feel(device):
    truth, recording = run(35.0, imu=DEVICES[device], site=LEVEL)
    gravity, earth = local_site()
    np.testing.assert_allclose(truth.gravity_r, gravity, rtol=0, atol=1e-6)
    np.testing.assert_allclose(truth.earth_rate_r, earth, rtol=0, atol=1e-15)
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, gravity, earth)


def test_a_faultless_device_at_the_tool_shows_rates_and_forces_themselves():
    """No sensor model at all between poses and readings: signs of the readings in their own frame."""
    truth, recording = run(25.0, imu={"errors": False, "lever_arm": (0, 0, 0), "lever_arm_spread": 0.0}, site=LEVEL)
    reference, imu = recording.reference, recording.imu
    omega, _, force = felt(reference.positions, reference.quaternions, *local_site(), 6)
    first = np.searchsorted(imu.stamps_ns, reference.stamps_ns[0]) + 4
    rows = slice(first, first + len(omega))
    np.testing.assert_allclose(imu.rates[rows], omega, rtol=0, atol=CORNER_RATE)
    np.testing.assert_allclose(imu.accelerations[rows], force, rtol=0, atol=CORNER_FORCE)
    # at rest the accelerometers show what holds them up
    up = Rotation.from_quat(reference.quaternions[0], scalar_first=True).as_matrix()[2]
    np.testing.assert_allclose(imu.accelerations[0], 9.8094 * up, rtol=0, atol=1e-3)
    assert not np.any(truth.sensors.lever_arms)


def test_another_arm_another_place():
    site = {"latitude_deg": -33.9, "height_m": 50.0, "heading_deg": 200.0, **LEVEL}
    truth, recording = run(25.0, seed=2, robot={"model": "ur10e"}, site=site, motion={"smoothing": 0.03})
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, *local_site(-33.9, 50.0, 200.0))


def test_a_tilted_base_tilts_gravity_and_earth_rate_alike():
    sd = 0.02
    tilts = []
    for seed in range(40):
        truth, _ = run(10.0, seed, site={"tilt_sd": sd}, motion={"first_rest": 10.0}, reference={"interval": 1.0})
        g, earth = local_site()
        assert np.linalg.norm(truth.gravity_r) == pytest.approx(-g[2], abs=1e-6)
        assert np.linalg.norm(truth.earth_rate_r) == pytest.approx(7.292115e-5, rel=1e-12)
        assert truth.gravity_r @ truth.earth_rate_r == pytest.approx(g @ earth, rel=1e-6)
        tilts.append(truth.gravity_r[:2] / 9.81)
    assert inside_chi_square(tilts, sd)


def test_tilted_readings_follow_the_tilted_truth():
    truth, recording = run(25.0, seed=3, site={"tilt_sd": 0.1})
    assert np.degrees(np.arccos(-truth.gravity_r[2] / np.linalg.norm(truth.gravity_r))) > 1.0
    reference = recording.reference
    agreement(truth, recording, reference.positions, reference.quaternions, truth.gravity_r, truth.earth_rate_r)


# Clocks


def test_time_convention(faultless):
    """t_imu = t_ref + offset + skew (t_ref - first), both ways.

    A spline through poses 2.5 ms apart is good to 5/384 H^4 of 12 500 m/s^4, 6e-9 m, and twice that at corners;
    stamps are rounded to 1 ns, 2e-9 m. Seconds wrong by a millionth of the skew would show.
    """
    _, recording = faultless
    path = CubicSpline((recording.reference.stamps_ns - START_NS) * 1e-9, recording.reference.positions)
    for offset, ppm in ((-1.7, 300.0), (0.4, -2000.0), (0.0371, 0.0)):
        drifting, other = run(reference={"interval": 0.012, "clock_offset": offset, "clock_drift_ppm": ppm})
        assert (drifting.time_offset, drifting.time_skew) == (offset, pytest.approx(ppm * 1e-6, rel=1e-12))
        t_ref = (other.reference.stamps_ns - START_NS) * 1e-9
        t_imu = t_ref + offset + ppm * 1e-6 * (t_ref - t_ref[0])
        assert t_imu[0] == pytest.approx(MARGIN, abs=1e-9)
        assert 30.0 - MARGIN - 0.013 < t_imu[-1] < 30.0 - MARGIN + 1e-9
        np.testing.assert_allclose(other.reference.positions, path(t_imu), rtol=0, atol=2e-8)
        np.testing.assert_array_equal(other.imu.rates, recording.imu.rates)
        np.testing.assert_array_equal(other.joints.stamps_ns, other.reference.stamps_ns)


def test_stamps_of_the_imu(faultless):
    _, recording = faultless
    assert recording.imu.stamps_ns[0] == START_NS
    np.testing.assert_array_equal(np.diff(recording.imu.stamps_ns), 2_500_000)
    assert recording.imu.stamps_ns.size == 30 * 400 + 1


# One error changes nothing else


NOISY = {"imu": {"noise": True}, "errors": {"path_position_sd": 5e-4, "repeatability_position_sd": 1e-4}}


@pytest.mark.parametrize(
    "change",
    [
        {"errors": {"path_position_sd": 2e-3, "path_orientation_sd": 1e-3}},
        {"errors": {"path_correlation_time": 0.0, "repeatability_position_sd": 1e-3}},
        {"errors": {"servo_lag": 0.02, "encoder_step": 1e-4}},
        {"errors": {"gear_eccentricity_sd": 1e-4, "sag_sd": 1e-4}},
        {"reference": {"jitter": 5e-4, "drop_share": 0.3, "clock_offset": 3.0, "interval": 0.012}},
        {"reference": {"measures": "position", "kind": "mocap"}},
    ],
)
def test_what_the_controller_reports_does_not_touch_the_imu(change):
    before, recording = run(12.0, seed=5, **NOISY)
    errors = {**NOISY["errors"], **change.get("errors", {})}
    after, other = run(12.0, seed=5, **{**NOISY, **change, "errors": errors})
    np.testing.assert_array_equal(other.imu.stamps_ns, recording.imu.stamps_ns)
    np.testing.assert_array_equal(other.imu.rates, recording.imu.rates)
    np.testing.assert_array_equal(other.imu.accelerations, recording.imu.accelerations)
    np.testing.assert_array_equal(after.sensors.K_a, before.sensors.K_a)
    np.testing.assert_array_equal(after.gravity_r, before.gravity_r)


@pytest.mark.parametrize(
    "imu",
    [{"noise": False}, {"grade": "fog"}, {"rate": 200.0}, {"errors": False}, {"drop_share": 0.2}, {"bandwidth": 50.0}],
)
def test_the_device_does_not_touch_the_poses(imu):
    _, recording = run(12.0, seed=5, **NOISY)
    _, other = run(12.0, seed=5, errors=NOISY["errors"], imu={"noise": True, **imu})
    np.testing.assert_array_equal(other.reference.positions, recording.reference.positions)
    np.testing.assert_array_equal(other.reference.quaternions, recording.reference.quaternions)


def test_errors_of_the_reports_add_up():
    """Path and repeatability together are each alone, with the same draws; positions round at 1e-16 of 3 m."""
    common = {"seconds": 20.0, "reference": {"interval": 0.012}}
    path, rest = {"path_position_sd": 1e-3}, {"repeatability_position_sd": 1e-3}
    at_path, at_rest, at_both, at_none = (
        run(errors=errors, **common)[1].reference.positions for errors in (path, rest, {**path, **rest}, {})
    )
    np.testing.assert_allclose(at_both - at_none, (at_path - at_none) + (at_rest - at_none), rtol=0, atol=5e-15)
    doubled = run(errors={"path_position_sd": 2e-3}, **common)[1].reference.positions
    np.testing.assert_allclose(doubled - at_none, 2.0 * (at_path - at_none), rtol=0, atol=5e-15)
    assert np.abs(at_path - at_none).max() > 1e-3


def test_noise_of_the_device_is_added():
    """The same draws, whatever the device measures."""
    noises = []
    for imu in ({"mounting_deg": (0.0, 0.0, 0.0)}, {"mounting_deg": (50.0, 20.0, -70.0), "lever_arm": (0.1, 0.2, 0.3)}):
        quiet, noisy = (run(12.0, imu={**imu, "noise": noise})[1].imu for noise in (False, True))
        noises.append(np.hstack([noisy.rates - quiet.rates, noisy.accelerations - quiet.accelerations]))
    np.testing.assert_allclose(noises[0], noises[1], rtol=0, atol=1e-13)
    assert np.all(noises[0].std(axis=0) > 1e-4)


def test_seeds_and_trials_are_different_cells():
    def positions(**which):
        return run(12.0, reference={"interval": 0.1}, **which)[1].reference.positions

    np.testing.assert_array_equal(positions(seed=5), positions(seed=5))
    np.testing.assert_array_equal(positions(seed=5, trial=1), positions(seed=5, trial=1))
    cells = [positions(seed=5), positions(seed=6), *(positions(seed=5, trial=k) for k in range(3))]
    for k, one in enumerate(cells):
        for other in cells[:k]:
            assert np.abs(one - other).max() > 0.1


# Errors of the arm, each alone


def rests_of(angles):
    """Masks of the stretches over which the joints stand, at least fifteen rows of them."""
    still = np.concatenate([[False], np.all(np.diff(angles, axis=0) == 0.0, axis=1), [False]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(still) > 0), np.flatnonzero(np.diff(still) < 0)
    masks = []
    for begin, end in zip(begins, ends, strict=True):
        if end - begin >= 15:
            mask = np.zeros(len(angles), dtype=bool)
            mask[begin : end + 1] = True
            masks.append(mask)
    return masks


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
    # between two rests it passes from one to the other, nowhere beyond, nowhere in a leap
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
    J = kinematics.regressor(load_arm("kr125"), other.joints.angles[some])
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


# Closure


@pytest.mark.parametrize(("seed", "joints"), [(1, True), (4, True), (1, False)])
def test_a_faultless_minute_is_calibrated_without_error(seed, joints):
    """What is left is integration between samples, 400 a second: some hundredths of a millionth."""
    truth, recording = run(60.0, seed, reference={"interval": 0.012, "clock_offset": 0.0371, "joints": joints})
    calibration = kreisel.calibrate(recording)
    found, true = calibration.sensors, truth.sensors
    assert np.abs(found.k_a - true.k_a).max() < 1e-5  # m/s^2
    assert np.abs(found.K_omega - true.K_omega).max() < 2e-8
    assert np.abs(found.K_a - true.K_a).max() < 2e-8
    assert np.abs(found.lever_arms - true.lever_arms).max() < 1e-6  # m
    assert np.abs(found.k_w - true.k_w).max() < 1e-8  # rad/s, 0.002 deg/h
    assert calibration.document["timing"]["offset"] == pytest.approx(0.0371, abs=1e-7)
    assert calibration.accepted


# Cells in files


def test_a_cell_and_its_program_lie_side_by_side(tmp_path):
    (tmp_path / "moves.toml").write_text(EXAMPLE, encoding="utf-8")
    file = tmp_path / "cell.toml"
    file.write_text('seconds = 100\n[motion]\nprogram = "moves.toml"\nfirst_rest = 3\n', encoding="utf-8")
    cell = read_cell(file)
    assert (cell.seconds, cell.motion.first_rest) == (100.0, 3.0)
    _, recording = simulate(cell.model_copy(update={"errors": Errors(**FAULTLESS)}), tmp_path / "r")
    # the recording ends where the program does, in its last rest
    assert 3.0 + 1.5 + 2.0 + 1.0 < recording.imu.seconds[-1] < 30.0
    np.testing.assert_allclose(np.degrees(recording.joints.angles[0]), [0, -90, 90, 0, 30, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording.reference.positions[-1], [1.5, 0.4, 1.6], rtol=0, atol=1e-9)
    rests = rests_of(recording.joints.angles)
    assert len(rests) == 3
    stop = recording.joints.angles[rests[1]][0]
    np.testing.assert_allclose(np.degrees(stop), [30, -70, 80, 20, 50, 40], rtol=0, atol=1e-9)


def test_the_example_has_every_key():
    content = tomllib.loads(example())
    unset = {line.split("=")[0].lstrip("# ").strip() for line in example().splitlines() if line.startswith("# ")}
    for name, info in Cell.model_fields.items():
        assert name in content
        table = info.annotation
        if isinstance(content[name], dict):
            assert content[name].keys() | unset >= table.model_fields.keys()


@pytest.mark.parametrize(
    ("text", "telling"),
    [
        (
            "second = 10\n",
            "unknown key 'second'; known are: errors, imu, motion, reference, robot, seconds, seed, site",
        ),
        (
            "[site]\nlatitude = 4\n",
            "unknown key 'site.latitude'; known are: heading_deg, height_m, latitude_deg, tilt_sd",
        ),
        ("errors = 5\n", "'errors' must be a table: write [errors]"),
        ("seconds = 5\n", "seconds = 5 is not accepted: Input should be greater than or equal to 10"),
        ("seconds = nan\n", "seconds = nan is not accepted"),
        ('[imu]\nrate = "fast"\n', "imu.rate = 'fast' is not accepted"),
        ('[imu]\ngrade = "best"\n', "unknown grade 'best'; known are: consumer-mems, fog, fog-mems, industrial-mems"),
        ("[imu]\nmounting_deg = [1, 2]\n", "imu.mounting_deg"),
        ('[reference]\nmeasures = "speed"\n', "reference.measures = 'speed' is not accepted"),
        ("seconds = \n", "not valid TOML"),
    ],
)
def test_what_is_wrong_with_a_cell_stands_in_one_line(tmp_path, text, telling):
    file = tmp_path / "cell.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError) as caught:
        read_cell(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert telling in str(caught.value)
    assert "\n" not in str(caught.value)


def test_arms_that_are_not_there_are_named():
    for robot, telling in (
        ({"model": "kr126"}, "unknown robot 'kr126'; known are: kr125, ur10e"),
        ({"tcp": "gripper"}, "unknown frame 'gripper'; known are: base_link"),
    ):
        with pytest.raises(RobotError, match=telling):
            run(12.0, robot=robot)


# The command


def command(*arguments):
    line = [sys.executable, "-m", "kreisel.cli.main", "simulate", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=120)


def test_printed_examples():
    done = command("--example")
    assert (done.returncode, done.stderr) == (0, "")
    assert Cell.model_validate(tomllib.loads(done.stdout)) == Cell()
    done = command("--example-program")
    assert (done.returncode, done.stderr, done.stdout) == (0, "", EXAMPLE)


def test_a_simulated_folder_is_a_recording(tmp_path):
    cell, out = tmp_path / "cell.toml", tmp_path / "out"
    cell.write_text('seconds = 20\n[imu]\ngrade = "fog"\n', encoding="utf-8")
    done = command(cell, "-o", out, "--seed", 9, "--seconds", 12)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"{out}: 12 s, 4801 IMU samples, ")
    assert f"kreisel calibrate {out} -o OUT" in done.stdout
    truth, recording = simulate(Cell.model_validate({"seed": 9, "seconds": 12, "imu": {"grade": "fog"}}), out)
    loaded = kreisel.load(out)
    np.testing.assert_array_equal(loaded.imu.rates, recording.imu.rates)
    np.testing.assert_array_equal(loaded.reference.positions, recording.reference.positions)
    np.testing.assert_array_equal(loaded.joints.angles, recording.joints.angles)
    assert loaded.urdf == load_arm("kr125").urdf
    assert loaded.settings == recording.settings
    written = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    np.testing.assert_array_equal(written["accelerometer"]["lever_arms"], truth.sensors.lever_arms)
    np.testing.assert_array_equal(written["robot"]["placement_error"], truth.arm.placement)
    assert written["time_offset"] == truth.time_offset
    # a second time: nothing is overwritten
    again = command(cell, "-o", out)
    assert again.returncode == 1
    assert "not empty" in again.stderr


@pytest.mark.parametrize(
    ("cell", "telling"),
    [
        ("[motion]\nspeed = 1\n", "unknown key 'motion.speed'; known are: first_rest, program, range_share, rest"),
        ('[imu]\ngrade = "best"\n', f"unknown grade 'best'; known are: {', '.join(sorted(GRADES))}"),
        ('[motion]\nprogram = "moves.toml"\n', "move 1: out of reach: the arm comes no nearer than"),
        ('[robot]\nmodel = "kr126"\n', "unknown robot 'kr126'; known are: kr125, ur10e"),
    ],
)
def test_failures_are_one_line_and_status_one(tmp_path, cell, telling):
    (tmp_path / "moves.toml").write_text("[[move]]\nposition = [5, 0, 1]\nabc_deg = [0, 0, 0]\n", encoding="utf-8")
    file = tmp_path / "cell.toml"
    file.write_text(cell, encoding="utf-8")
    done = command(file, "-o", tmp_path / "out")
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert telling in done.stderr


def test_where_to_write_must_be_said():
    done = command()
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "-o RECORDING" in done.stderr
    assert command("--no-such-option").returncode == 2


def test_an_mcap_file_may_be_asked_for(tmp_path):
    done = command("-o", tmp_path / "x.mcap", "--seconds", 12)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x.truth.json").is_file()
    assert kreisel.load(tmp_path / "x.mcap").imu.stamps_ns.size > 2000


def test_a_level_base_and_jittered_poses():
    """No tilt at all, and moments taken out of their order: every number stays one."""
    cell = Cell.model_validate({"seconds": 12, "site": {"tilt_sd": 0}, "reference": {"jitter": 0.004}})
    _, recording = simulate(cell, Path("x"))
    assert np.isfinite(recording.reference.positions).all()
    assert np.isfinite(recording.imu.accelerations).all()


def test_coefficients_without_a_reading_are_refused():
    cell = Cell.model_validate({"seed": 2, "seconds": 20, "imu": {"noise": False, "quadratic_gyro_sd": 0.1,
                                                                  "quadratic_accel_sd": 0.01}})  # fmt: skip
    with pytest.raises(SettingsError, match="no reading corresponds"):
        simulate(cell, Path("x"))


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [("imu", "quadratic_gyro_sd", 1e-3), ("errors", "sag_sd", 1e-4), ("reference", "jitter", 1e-6)],
)
def test_further_errors_leave_other_draws_alone(table, key, value):
    plain, other = (simulate(Cell.model_validate({"seconds": 12, table: {key: v}}), Path("x")) for v in (0.0, value))
    np.testing.assert_array_equal(plain[0].sensors.K_a, other[0].sensors.K_a)
    np.testing.assert_array_equal(plain[0].sensors.lever_arms, other[0].sensors.lever_arms)
    np.testing.assert_array_equal(plain[0].arm.lag, other[0].arm.lag)
    apart = np.abs(plain[1].reference.positions - other[1].reference.positions).max()
    assert apart < 1e-3  # repeatability drawn anew would move poses by 0.3 mm and more; sag and jitter by less

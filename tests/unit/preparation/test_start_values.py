"""Start and prior: covariances against maps and information written out, values against those of a recording."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from kreisel.inertial.earth import EARTH_RATE
from kreisel.model.groups import USUAL_SKEW
from kreisel.model.standstill import OutsideStandstill
from kreisel.preparation.start_values import (
    START_INFLATION,
    _cross_coupling_prior,
    _nearly_orthogonal,
    _turned_by_robot,
    _with_stated,
    _without_turn,
    nominal_parameters,
    starting_point,
    stated_prior,
)

from ...oracle.quaternions import rotate
from ...small_problem import with_fit

MOUNT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
COUPLING_SD, NON_ORTHOGONALITY = 0.05, 0.015


def with_noise(prepared, **changed):
    return replace(prepared, imu_noise=replace(prepared.imu_noise, **changed))


def with_force(prepared, **changed):
    return replace(prepared, accelerometer_fit=replace(prepared.accelerometer_fit, **changed))


def with_reference(prepared, **changed):
    return replace(prepared, reference=replace(prepared.reference, **changed))


# ---------------------------------------------------------------- cross-couplings


def coupling(R, scale, shear, turn):
    """K = R (1 + E): scale errors, half the sum and half the difference of each pair of couplings."""
    E = np.diag(scale)
    for s, a, (i, j) in zip(shear, turn, ((0, 1), (0, 2), (1, 2)), strict=True):
        E[i, j], E[j, i] = s + a, s - a
    return R @ (np.eye(3) + E)


@pytest.mark.parametrize("turn", [0.2, 1e-6])
def test_the_prior_of_couplings_is_that_of_scale_shear_and_turn(turn):
    sd = np.repeat([COUPLING_SD, NON_ORTHOGONALITY, turn], 3)
    columns = [coupling(MOUNT, *np.split(e, 3)).ravel() - MOUNT.ravel() for e in np.diag(sd)]  # the map is linear
    np.testing.assert_allclose(_cross_coupling_prior(MOUNT, turn), np.array(columns).T @ np.array(columns), atol=1e-17)


def least_squares(P, H, sd):
    """Covariance and gain by information, P^-1 + H^T H / sd^2: nothing shared with the gain of a filter."""
    after = np.linalg.inv(np.linalg.inv(P) + H.T @ H / sd**2)
    return after, after @ np.linalg.inv(P)


def test_triads_are_nearly_square_where_the_motion_does_not_say():
    rng = np.random.default_rng(2)
    K = coupling(MOUNT, [0.02, -0.01, 0.0], [0.03, -0.02, 0.01], [0.0, 0.0, 0.0])
    deviation = rng.uniform(1e-3, 0.05, (3, 3))
    R = polar(K)[0]

    def shears(flat):
        E = R.T @ flat.reshape(3, 3)
        return np.array([0.5 * (E[i, j] + E[j, i]) for i, j in ((0, 1), (0, 2), (1, 2))])

    H = np.array([shears(e) for e in np.eye(9)]).T
    expected, keeps = least_squares(np.diag(deviation.ravel() ** 2), H, NON_ORTHOGONALITY)
    mean, P = _nearly_orthogonal(K, deviation)
    np.testing.assert_allclose(P, expected, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(mean.ravel(), keeps @ K.ravel(), atol=1e-13)
    assert np.all(np.abs(shears(mean.ravel())) < np.abs(shears(K.ravel())))


def test_couplings_the_motion_shows_well_are_left_alone():
    K = coupling(MOUNT, [0.02, -0.01, 0.0], [0.03, -0.02, 0.01], [0.0, 0.0, 0.0])
    mean, P = _nearly_orthogonal(K, np.full((3, 3), 1e-5))
    np.testing.assert_allclose(mean, K, atol=1e-7)  # (1e-5 / 0.015)^2 of 0.03 is taken off
    np.testing.assert_allclose(np.sqrt(np.diag(P)), 1e-5, rtol=1e-5)


def test_a_matrix_known_not_to_turn_keeps_only_symmetric_uncertainty():
    A = np.random.default_rng(4).normal(0.0, 0.01, (9, 9))
    P = A @ A.T + 1e-4 * np.eye(9)
    H = np.zeros((3, 9))
    for row, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):  # half the difference of two couplings: a turn
        H[row, 3 * i + j], H[row, 3 * j + i] = 0.5, -0.5
    found = _without_turn(P)
    np.testing.assert_allclose(found, least_squares(P, H, 1e-6)[0], rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(np.sqrt(np.diag(H @ found @ H.T)), 1e-6, rtol=1e-3)
    np.testing.assert_array_equal(found, found.T)
    assert np.linalg.eigvalsh(found).min() > 0.0


# ---------------------------------------------------------------- small rules


def test_what_is_stated_of_an_offset_gives_way_to_a_fit_that_says_more():
    value, sd = np.array([0.1, 0.2, 0.3]), np.array([1e-4, 1e-3, 1.0])
    found, deviation = _with_stated(value, sd, 0.01, 0.05)
    np.testing.assert_array_equal(found, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(deviation, [START_INFLATION * 1e-4, 0.01, 0.01])
    found, deviation = _with_stated(value, sd, None, 0.05)
    np.testing.assert_array_equal(found, value)
    np.testing.assert_allclose(deviation, [START_INFLATION * 1e-4, START_INFLATION * 1e-3, 0.05])


def test_a_robot_turns_its_tool_by_all_of_its_placements_together():
    sd = np.random.default_rng(5).uniform(1e-4, 1e-3, (7, 6))
    robot = SimpleNamespace(covariance={"robot_placement": np.diag(sd.ravel() ** 2)})
    turns = np.random.default_rng(6).normal(0.0, 1.0, (40_000, 7, 3)) * sd[:, 3:]
    # small turns add; twice their deviation about an axis. 120 000 numbers: 0.2 %
    assert _turned_by_robot(robot) == pytest.approx(2.0 * np.sqrt(np.mean(turns.sum(axis=1) ** 2)), rel=0.01)
    assert _turned_by_robot(None) == 0.0


@pytest.mark.parametrize(("degrees", "square"), [(2.9, True), (3.1, False)])
@pytest.mark.parametrize("axes", [np.eye(3), np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.diag([-1.0, -1, 1])])
def test_a_mount_within_three_degrees_of_the_axes_is_taken_for_one_along_them(prepared, axes, degrees, square):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    R = axes @ Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    found = nominal_parameters(with_fit(prepared, K_omega=1.02 * R), 1).sensors
    np.testing.assert_allclose(found.K_omega, axes if square else R, atol=1e-12)
    np.testing.assert_array_equal(found.K_a, found.K_omega)


def test_an_oblique_mount_is_taken_as_it_is(prepared):
    found = nominal_parameters(with_fit(prepared, K_omega=MOUNT @ np.diag([1.01, 0.98, 1.0])), 3).sensors
    assert np.linalg.norm(found.K_omega - MOUNT) < 0.02
    np.testing.assert_allclose(found.K_omega @ found.K_omega.T, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(found.k_w, np.zeros((3, 3)))
    np.testing.assert_array_equal(found.lever_arms, np.zeros((3, 3)))


# ---------------------------------------------------------------- the start


def test_the_truth_lies_within_the_deviations_of_the_start(cell):
    """Twenty deviations of a fit, or what is known of usual devices: three of them are never reached."""
    truth, prepared = cell
    start, covariance = starting_point(prepared, 1)
    found, s = start.sensors, truth.sensors
    for group, error in {
        "gyro_cross_coupling": found.K_omega - s.K_omega,
        "gyro_offset": found.k_w - s.k_w,
        "accel_cross_coupling": found.K_a - s.K_a,
        "accel_offset": found.k_a - s.k_a,
        "lever_arms": found.lever_arms - s.lever_arms,
    }.items():
        sd = np.sqrt(np.diag(covariance[group]))
        assert np.abs(error.ravel() / sd).max() < 3.0, group
    down = rotate(start.q_rn, np.array([0.0, 0.0, 1.0]))
    tilt = np.linalg.norm(np.cross(down, truth.gravity_r / np.linalg.norm(truth.gravity_r)))
    assert tilt < 3.0 * np.sqrt(covariance["alignment"][0, 0])


def test_the_deviations_of_the_fits_are_widened_within_bounds(prepared):
    made = with_fit(
        prepared,
        K_omega_sd=np.array([[1e-6, 1e-3, 1.0]] * 3),
        clock=replace(prepared.rate_fit.clock, start_sd=2e-4, skew_sd=3e-6),
    )
    made = with_force(made, tilt_sd=1e-3)
    _, P = starting_point(made, 1)
    assert P["time_offset"][0, 0] == pytest.approx((START_INFLATION * 2e-4) ** 2)
    assert P["time_skew"][0, 0] == pytest.approx((START_INFLATION * 3e-6) ** 2)
    np.testing.assert_allclose(P["alignment"], (START_INFLATION * 1e-3) ** 2 * np.eye(2), rtol=1e-12)
    _, expected = _nearly_orthogonal(made.rate_fit.K_omega, np.array([[1e-3, 0.02, 0.05]] * 3))
    np.testing.assert_allclose(P["gyro_cross_coupling"], expected, rtol=1e-12)
    tight = with_fit(prepared, clock=replace(prepared.rate_fit.clock, start_sd=1e-9, skew_sd=1e-12))
    _, P = starting_point(with_force(tight, tilt_sd=1e-9), 1)
    assert (P["time_offset"][0, 0], P["time_skew"][0, 0]) == pytest.approx((1e-6, 1e-12))
    np.testing.assert_allclose(np.diag(P["alignment"]), 1e-8, rtol=1e-12)


def test_what_a_robots_errors_turn_is_left_open(prepared):
    """Fits far better than the arm: its seven placements turn the tool by twice sqrt(7) 2 mrad."""
    angle = 2e-3
    covariance = {"robot_placement": np.diag(np.tile([1e-3, 1e-3, 1e-3, angle, angle, angle], 7) ** 2)}
    robot = SimpleNamespace(covariance=covariance, joints=6)
    made = with_fit(prepared, K_omega_sd=np.full((3, 3), 1e-9))
    made = replace(with_force(made, K_a_sd=np.full((3, 3), 1e-9), tilt_sd=1e-9), robot=robot)
    start, P = starting_point(made, 1)
    turn = 2.0 * np.sqrt(7.0) * angle
    np.testing.assert_allclose(np.sqrt(np.diag(P["alignment"])), turn, rtol=1e-12)
    for group, K in (
        ("gyro_cross_coupling", made.rate_fit.K_omega),
        ("accel_cross_coupling", made.accelerometer_fit.K_a),
    ):
        np.testing.assert_allclose(P[group], _nearly_orthogonal(K, np.full((3, 3), turn))[1], rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(P["robot_placement"], covariance["robot_placement"])
    assert start.robot.placement.shape == (7, 6)


def test_accelerometers_the_motion_hardly_shows_start_as_the_gyros_are_mounted(prepared):
    sd = np.full((3, 3), 1e-4)
    sd[:, 2] = 0.01  # twenty times that is more than is known of any device
    start, _ = starting_point(with_force(prepared, K_a_sd=sd), 1)
    mount = nominal_parameters(prepared, 1).sensors.K_a
    found = prepared.accelerometer_fit.K_a
    expected, _ = _nearly_orthogonal(np.column_stack([found[:, :2], mount[:, 2]]), np.array([[2e-3, 2e-3, 0.05]] * 3))
    np.testing.assert_allclose(start.sensors.K_a, expected, atol=1e-12)


def test_a_standstill_outside_the_reference_shows_the_gyros_offset(prepared):
    density = np.array([1e-5, 1e-5, 1.0])
    rate = np.array([1e-3, -2e-3, 3e-3])
    made = replace(with_noise(prepared, gyro=density), outside_standstill=OutsideStandstill(rate, 16.0))
    made = with_noise(made, gyro_offset_sd=0.01)
    made = with_fit(made, k_w0_sd=np.full(3, 1.0))
    start, P = starting_point(made, 1)
    prior, Q = stated_prior(made, 1)
    # twice the root of the noise of a mean over 16 s and of the Earth's rate, which is taken for an offset
    known = 2.0 * np.sqrt(1e-10 / 16.0 + EARTH_RATE**2)
    for value, covariance in ((start, P), (prior, Q)):
        np.testing.assert_allclose(value.sensors.k_w[0, :2], -rate[:2])
        np.testing.assert_allclose(np.sqrt(np.diag(covariance["gyro_offset"])), [known, known, 0.01], rtol=1e-9)
        assert value.sensors.k_w[0, 2] == 0.0  # so noisy a gyro shows less than is stated


def test_polynomials_the_fits_know_nothing_of_keep_offsets_and_couplings_open(prepared):
    made = with_force(with_fit(prepared, k_w0_sd=np.full(3, 1e-9)), k_a0_sd=np.full(3, 1e-9))
    for stated, expected in ((None, (0.01, 0.3)), ((2e-3, 0.05), (2e-3, 0.05))):
        gyro, accel = stated or (None, None)
        start, P = starting_point(with_noise(made, gyro_offset_sd=gyro, accel_offset_sd=accel), 3)
        np.testing.assert_allclose(np.sqrt(np.diag(P["gyro_offset"])), expected[0], rtol=1e-12)
        np.testing.assert_allclose(np.sqrt(np.diag(P["accel_offset"])), expected[1], rtol=1e-12)
    assert start.sensors.k_w.shape == start.sensors.k_a.shape == (3, 3)
    np.testing.assert_array_equal(start.sensors.k_a[1:], 0.0)
    assert P["gyro_polynomial"].shape == (6, 6)
    symmetric = np.sqrt(np.diag(P["gyro_cross_coupling"]))
    assert symmetric.min() > NON_ORTHOGONALITY / 2.0  # 0.02, less what squareness says


def test_what_positions_and_orientations_do_not_show(prepared):
    without_p = with_reference(prepared, positions=None)
    start, _ = starting_point(with_force(without_p, lever_arm=np.array([0.1, 0.2, 0.3])), 1)
    np.testing.assert_array_equal(start.sensors.lever_arms, np.zeros((3, 3)))
    start, _ = starting_point(with_force(prepared, lever_arm=np.array([0.1, 0.2, 0.3])), 1)
    np.testing.assert_array_equal(start.sensors.lever_arms, [[0.1, 0.2, 0.3]] * 3)
    without_q = with_fit(with_reference(prepared, quaternions=None), K_omega=np.eye(3))
    for covariance in (starting_point(without_q, 1)[1], stated_prior(without_q, 1)[1]):
        P = covariance["gyro_cross_coupling"]
        turn = np.zeros(9)
        turn[1], turn[3] = 0.5, -0.5
        assert np.sqrt(turn @ P @ turn) < 2e-6  # b is what the gyros' axes are


# ---------------------------------------------------------------- the prior


def test_the_prior_is_that_of_any_device_on_the_mount_found(prepared):
    made = with_noise(prepared, gyro_offset_sd=None, accel_offset_sd=None)
    made = with_fit(made, K_omega=MOUNT @ np.diag([1.01, 0.98, 1.0]))
    value, P = stated_prior(made, 2)
    R = polar(made.rate_fit.K_omega)[0]
    for K in (value.sensors.K_omega, value.sensors.K_a):
        np.testing.assert_allclose(K, R, atol=1e-12)
    for part in (value.sensors.k_w, value.sensors.k_a, value.sensors.lever_arms):
        np.testing.assert_array_equal(part, 0.0)
    assert (value.start, value.skew) == (made.rate_fit.clock.start, 0.0)
    sd = {group: np.sqrt(np.diag(p)) for group, p in P.items()}
    assert set(sd["gyro_offset"]) == {0.3}
    assert set(sd["accel_offset"]) == {2.0}
    assert sd["time_skew"] == pytest.approx([USUAL_SKEW])
    assert sd["lever_arms"] == pytest.approx(np.full(9, 0.2))
    assert sd["alignment"] == pytest.approx([0.3, 0.3])
    assert sd["time_offset"] == pytest.approx([1.0])
    np.testing.assert_array_equal(P["gyro_cross_coupling"], P["accel_cross_coupling"])


def test_the_prior_takes_the_users_word_of_offsets_and_of_gravity(prepared):
    made = with_noise(prepared, gyro_offset_sd=1e-4, accel_offset_sd=0.02)
    made = replace(made, outside_standstill=None, site=replace(made.site, gravity=9.81, gravity_sd=3e-4))
    value, P = stated_prior(made, 1)
    assert value.gravity == 9.81
    np.testing.assert_allclose(P["gyro_offset"], 1e-8 * np.eye(3), rtol=1e-12)
    np.testing.assert_allclose(P["accel_offset"], 4e-4 * np.eye(3), rtol=1e-12)
    assert P["gravity"][0, 0] == pytest.approx(9e-8)


@pytest.mark.parametrize("known", [True, False])
def test_the_earths_rate_is_one_unit_north_or_three_unknowns(prepared, known):
    rate = prepared.site.earth_rate_n if known else None
    made = replace(prepared, site=replace(prepared.site, earth_rate_n=rate))
    for value, P in (starting_point(made, 1), stated_prior(made, 1)):
        assert value.earth_down == (1.0 if known else 0.0)
        np.testing.assert_array_equal(value.north, 0.0)
        np.testing.assert_allclose(np.sqrt(np.diag(P["north"])), 0.7 if known else 3**-0.5, rtol=1e-12)
        if not known:
            # so that the expected square of the whole is one
            assert np.trace(P["north"]) + P["earth_down"][0, 0] == pytest.approx(1.0)

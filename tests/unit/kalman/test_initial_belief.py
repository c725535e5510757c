"""Where the filter begins: beliefs against the covariances they stand for, poses against curves and SciPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from kreisel.fitting.reported_poses import pose_near
from kreisel.fitting.stored_state import first_belief, parameters_of, stored_state
from kreisel.kalman.navigation_start import navigation_from_reference
from kreisel.model.assumed_noise import PoseError
from kreisel.model.parameters import GROUPS
from kreisel.model.problem import with_correlation_time, without_groups

from ...oracle import quaternions as quat
from ...small_problem import random_belief, small_problem, with_noise

NAVIGATION = ("velocity", "position", "attitude")


def block(problem, belief, name, other=None):
    return belief.covariance[problem.layout[name], problem.layout[other or name]]


def test_parameters_come_back_from_the_stored_state():
    problem = small_problem()
    start = problem.prior.start
    x = stored_state(problem, start)
    found = parameters_of(problem, problem.prior.nominal, x)
    for group in GROUPS:
        want = start if group in problem.layout else problem.prior.nominal
        np.testing.assert_array_equal(found.stored(group), want.stored(group))
    np.testing.assert_array_equal(x[problem.layout.stored("attitude")], [1.0, 0.0, 0.0, 0.0])
    for name in ("velocity", "position", "standstill_position", "path_orientation"):
        assert not x[problem.layout.stored(name)].any()


def test_groups_that_are_not_in_the_state_keep_what_is_known():
    problem = without_groups(small_problem(), ("lever_arms", "gyro_offset"))
    other = replace(problem.prior.start, gravity=1.0)
    found = parameters_of(problem, other, stored_state(problem, problem.prior.start))
    np.testing.assert_array_equal(found.sensors.lever_arms, other.sensors.lever_arms)
    assert found.gravity == problem.prior.start.gravity


@pytest.mark.parametrize("stated", [True, False])
def test_the_first_belief_has_the_covariance_of_each_group_and_none_between_them(stated):
    problem = small_problem()
    rng = np.random.default_rng(0)
    covariance = None
    if stated:
        covariance = {g: np.cov(rng.normal(size=(P.shape[0], 50))) for g, P in problem.prior.covariance.items()}
        covariance = {g: np.atleast_2d(P) for g, P in covariance.items()}
    belief = first_belief(problem, problem.prior.start, covariance)
    want = np.zeros((problem.layout.degrees,) * 2)
    for group, P in (covariance or problem.prior.start_covariance).items():
        if group not in problem.layout:
            continue
        want[problem.layout[group], problem.layout[group]] = P
    n = len(problem.parameter_names)
    np.testing.assert_allclose(belief.covariance[:n, :n], want[:n, :n], rtol=1e-10, atol=1e-300)
    assert not belief.covariance[:n, n:].any()
    np.testing.assert_array_equal(belief.mean, stored_state(problem, problem.prior.start))


def test_errors_of_the_reference_begin_with_their_own_variance():
    problem = with_noise(small_problem(), pose_error=PoseError(3e-3, 2e-3, 5.0))
    noise = problem.noise.reference
    belief = first_belief(problem, problem.prior.start)
    for name, variance in (
        ("standstill_position", noise.standstill_position**2 + 3e-3**2),
        ("standstill_orientation", noise.standstill_orientation**2 + 2e-3**2),
        ("path_position", 3e-3**2),
        ("path_orientation", 2e-3**2),
    ):
        np.testing.assert_allclose(block(problem, belief, name), variance * np.eye(3), rtol=1e-12)
    coloured = with_correlation_time(with_noise(problem, pose_error=PoseError()), 2.0)
    belief = first_belief(coloured, problem.prior.start)
    np.testing.assert_allclose(
        block(coloured, belief, "path_position"), 0.9 * noise.position**2 * np.eye(3), rtol=1e-12
    )


@pytest.mark.parametrize("at", [3.2, 10.0001, 25.7])
def test_the_pose_near_a_time_lies_on_a_line_between_its_neighbours(at):
    reference = small_problem().reference
    q, p, _ = pose_near(reference, at)
    tau = reference.seconds
    np.testing.assert_allclose(p, [np.interp(at, tau, column) for column in reference.positions.T], rtol=1e-12)
    want = Slerp(tau, Rotation.from_quat(reference.quaternions, scalar_first=True))(at)
    assert (Rotation.from_quat(q, scalar_first=True).inv() * want).magnitude() < 1e-7


def test_the_velocity_near_a_time_is_that_of_a_parabola_in_the_middle_of_an_interval():
    """Differences over as many poses on either side are exact for a parabola, wherever these poses lie."""
    reference = small_problem().reference
    tau = reference.seconds
    v, a = np.array([0.3, -0.2, 0.1]), np.array([1.0, 2.0, -3.0])
    curve = replace(reference, positions=tau[:, None] * v + 0.5 * tau[:, None] ** 2 * a)
    k = 1000
    middle = 0.5 * (tau[k] + tau[k + 1])
    np.testing.assert_allclose(pose_near(curve, middle)[2], v + a * middle, rtol=1e-10)


@pytest.mark.parametrize("end", [0, -1])
def test_at_the_ends_of_the_reference_its_line_is_drawn_on(end):
    reference = small_problem().reference
    tau = reference.seconds
    v = np.array([0.3, -0.2, 0.1])
    straight = replace(reference, positions=tau[:, None] * v, quaternions=None)
    at = tau[end] + (-0.004 if end == 0 else 0.004)
    q, p, found = pose_near(straight, at)
    np.testing.assert_allclose(p, at * v, atol=1e-12)
    np.testing.assert_allclose(found, v, rtol=1e-10)
    np.testing.assert_array_equal(q, [1.0, 0.0, 0.0, 0.0])


def test_without_positions_nothing_is_said_of_place_and_velocity():
    reference = replace(small_problem().reference, positions=None)
    _, p, v = pose_near(reference, 5.0)
    assert not p.any()
    assert not v.any()


def test_navigation_begins_anew_with_the_pose_at_the_sample_and_no_memory():
    problem = small_problem()
    belief = random_belief(problem, np.random.default_rng(2))
    at = 12
    update = problem.schedule.updates[at]
    found = navigation_from_reference(problem, problem.prior.start, belief, at)
    clock = problem.prior.start.clock
    tau = (problem.sensor.readings.stamps[update.first] - clock.start) / (1.0 + clock.skew)
    q, p, v = pose_near(problem.reference, tau)
    layout = problem.layout
    for name, value, deviation in (("attitude", q, 0.02), ("velocity", v, 0.3), ("position", p, 0.02)):
        np.testing.assert_allclose(found.mean[layout.stored(name)], value, rtol=1e-12)
        np.testing.assert_allclose(block(problem, found, name), deviation**2 * np.eye(3), rtol=1e-10, atol=1e-14)
        np.testing.assert_allclose(block(problem, found, name, "gyro_offset"), 0.0, atol=1e-14)
    np.testing.assert_allclose(block(problem, found, "velocity", "position"), 0.0, atol=1e-14)
    n = len(problem.parameter_names)
    np.testing.assert_allclose(found.covariance[:n, :n], belief.covariance[:n, :n], rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize(("at", "row"), [(0, 0), (12, 11)])
def test_without_orientations_the_attitude_is_that_known_for_the_sample_it_starts_from(at, row):
    """The first update starts from its own sample, a later one from that of the update before."""
    problem = small_problem()
    schedule = problem.schedule
    known = quat.exp(np.random.default_rng(3).normal(size=(len(schedule.updates), 3)))
    problem = replace(
        problem, reference=replace(problem.reference, quaternions=None),
        schedule=replace(schedule, attitude=known, attitude_sd=0.07),
    )  # fmt: skip
    belief = random_belief(problem, np.random.default_rng(4))
    found = navigation_from_reference(problem, problem.prior.start, belief, at)
    np.testing.assert_array_equal(found.mean[problem.layout.stored("attitude")], known[row])
    np.testing.assert_allclose(block(problem, found, "attitude"), 0.07**2 * np.eye(3), rtol=1e-10, atol=1e-14)
    without = replace(problem, reference=replace(problem.reference, positions=None))
    found = navigation_from_reference(without, problem.prior.start, belief, at)
    np.testing.assert_allclose(block(problem, found, "velocity"), np.eye(3), rtol=1e-10, atol=1e-14)  # 1 m/s
    assert not found.mean[problem.layout.stored("velocity")].any()

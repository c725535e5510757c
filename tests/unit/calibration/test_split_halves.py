"""Two halves of a recording: their difference in a linear model, exactly; and a cell whose offset steps."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.disagreement import Disagreement
from kreisel.calibration.evidence import SplitHalves
from kreisel.calibration.frame_errors import frame_columns, repeatability_columns
from kreisel.calibration.split_halves import halves_disagreement, middle_of, split_halves
from kreisel.estimation.belief import Belief
from kreisel.fitting.stored_state import first_belief, stored_state
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.assumed_noise import GaussMarkov
from kreisel.model.problem import part_of, with_readings, without_groups
from kreisel.model.schedule import MIN_UPDATES
from kreisel.refinement.estimate import without_passing

from ...small_problem import GivenFits, camera_problem, estimate_of, small_problem, small_run, with_drifts, with_noise

OFFSETS = ("gyro_offset", "accel_offset")


def with_disagreement(found, halves):
    more = halves_disagreement(found, halves)
    return found.adding(more.contributions, more.warnings)


def linear_halves(walk=0.0, factor=1.0, weak=1.0, length=0.0):
    """Halves that are linear in six offsets, and the exact covariance of their difference.

    The estimate of a half is K_i (H_i x + e_i) with x drawn from the prior: the difference of two is linear in x,
    e_1 and e_2, whose covariances are known.
    """
    problem = without_groups(small_problem(), tuple(g for g in small_problem().groups if g not in OFFSETS))
    problem = with_noise(problem, offset_walk=dict.fromkeys(OFFSETS, walk), frame_sd=(length, length))
    rng = np.random.default_rng(0)
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance)
    P = prior.covariance[:6, :6]
    runs, gains = [], []
    for strength in (1.0, weak):
        H = strength * rng.normal(size=(8, 6)) / np.sqrt(np.diag(P))
        K = np.linalg.solve(H.T @ H + np.linalg.inv(P), H.T)
        x = 0.1 * np.sqrt(np.diag(P)) * rng.normal(size=6)
        belief = first_belief(problem, problem.prior.start)
        own, mean = belief.factor.copy(), stored_state(problem, problem.prior.value)
        own[:6, :6] = np.linalg.cholesky(np.linalg.inv(H.T @ H + np.linalg.inv(P)))
        mean[:6] = x
        runs.append(replace(small_run(), parameters=problem.prior.start, belief=Belief(mean, own)))
        gains.append((K @ H, K))
    (first, first_gain), (second, second_gain) = gains
    exact = (first - second) @ P @ (first - second).T + first_gain @ first_gain.T + second_gain @ second_gain.T
    return estimate_of(problem, runs[0], correlation_factor=factor), runs, exact


def compared(**made):
    found, runs, exact = linear_halves(**made)
    return split_halves(replace(found, estimator=GivenFits(runs))), runs, exact


@pytest.mark.parametrize("weak", [1.0, 0.1, 1e-2])
def test_the_variance_of_the_difference_is_that_of_two_halves_with_one_prior(weak):
    """(22). A half that sees nothing follows the prior, and differs by the other's own distance from it."""
    halves, runs, exact = compared(weak=weak)
    np.testing.assert_allclose(halves.deviation, np.sqrt(np.diag(exact)), rtol=1e-6)
    np.testing.assert_allclose(halves.difference, (runs[1].belief.mean - runs[0].belief.mean)[:6], rtol=1e-12)
    assert halves.names == tuple(f"{s}.offset[{i}]" for s in ("gyroscope", "accelerometer") for i in range(3))


def test_the_prior_holds_halves_together_that_see_nothing():
    """Both follow it: their difference is far less uncertain than either, and its deviation does not vanish."""
    found, runs, _ = linear_halves()
    prior = first_belief(found.problem, found.problem.prior.value, found.problem.prior.covariance)
    blind = [replace(run, belief=replace(run.belief, factor=prior.factor)) for run in runs]
    halves = split_halves(replace(found, estimator=GivenFits(blind)))
    own = prior.standard_deviation[:6]
    assert np.all(halves.deviation > 0.0)
    assert np.all(halves.deviation < 0.02 * own)


def test_correlated_innovations_a_walk_and_frames_that_err_are_added():
    plain, _, exact = compared()
    wide, _, _ = compared(factor=1.7)
    np.testing.assert_allclose(wide.deviation, 1.7 * plain.deviation, rtol=1e-9)
    walking, _, _ = compared(walk=1e-4)
    problem = small_problem()
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    # the mean offsets of two halves of a random walk over T lie apart by one of T / 3; half of T is an upper bound
    gathered = 0.5e-8 * (stamps[updates[-1].last] - stamps[updates[0].first])
    np.testing.assert_allclose(walking.deviation**2, np.diag(exact) + gathered, rtol=1e-6)


def test_errors_of_the_frames_are_added_here_too(steady):
    problem = with_noise(camera_problem(), frame_sd=(2e-3, 1e-3))
    run = KalmanFilter().fit(problem)
    halves = split_halves(estimate_of(problem, run))
    n = len(halves.names)
    columns = frame_columns(problem, run.parameters)[:n]
    standstills = 4.0 * np.sum(repeatability_columns(camera_problem(), run.parameters)[:n] ** 2, axis=1)
    want = steady.deviation**2 - standstills + np.sum(columns**2, axis=1)  # which are part of the frames' errors
    np.testing.assert_allclose(halves.deviation**2, want, rtol=1e-9)
    assert np.all(halves.deviation[problem.layout["lever_arms"]] > 0.8 * 2e-3)


def test_too_short_halves_are_not_compared():
    problem = small_problem()
    updates = problem.schedule.updates
    for count, none in ((2 * MIN_UPDATES - 1, True), (2 * MIN_UPDATES, False)):
        schedule = replace(problem.schedule, updates=updates[:count], attitude=problem.schedule.attitude[:count])
        found = split_halves(estimate_of(replace(problem, schedule=schedule), small_run()))
        assert (found is None) == none


def test_a_part_begins_navigation_and_its_standstill_anew():
    problem = small_problem()
    updates = problem.schedule.updates
    still = next(i for i, u in enumerate(updates) if i > 20 and u.standstill is not None and not u.new_standstill)
    moving = next(i for i, u in enumerate(updates) if i > 20 and u.standstill is None)
    for at, new in ((still, True), (moving, False)):
        schedule = part_of(problem, slice(at, at + 25)).schedule
        first = schedule.updates[0]
        assert first.new_segment
        assert first.new_standstill is new
        assert first.first == first.last == updates[at].last
        assert schedule.updates[1:] == updates[at + 1 : at + 25]
        np.testing.assert_array_equal(schedule.attitude, problem.schedule.attitude[at : at + 25])
    assert updates[still].first < updates[still].last  # the whole is as it was


def test_a_part_of_all_updates_gives_the_result_of_all():
    """Relinearised about a result that needed no further pass: it moves by far less than a deviation."""
    problem = camera_problem()
    run = KalmanFilter().fit(problem)
    again = KalmanFilter().refit(part_of(problem, slice(0, None)), run)
    n = len(problem.parameter_names)
    off = problem.layout.minus(again.belief.mean[:, None], run.belief.mean)[:n, 0]
    assert np.abs(off / run.belief.standard_deviation[:n]).max() < 0.2


@pytest.fixture(scope="module")
def steady():
    return split_halves(estimate_of(camera_problem(), KalmanFilter().fit(camera_problem())))


def test_halves_of_a_steady_cell_agree(steady):
    """45 scores, of which one in two million exceeds five in absolute value."""
    assert np.abs(steady.score).max() < 5.0
    assert 0.3 < np.sqrt(np.mean(steady.score**2)) < 1.7


def test_an_offset_that_steps_in_the_middle_shows_as_large_as_it_is(steady):
    """Readings that grow by a step need an offset that falls by it; the step enters through K_omega, 1 % from one."""
    problem = camera_problem()
    middle = problem.schedule.updates[middle_of(problem)].last
    step = np.array([2e-4, -3e-4, 1e-4])
    rates = problem.sensor.readings.rates.copy()
    rates[middle:] += step
    readings = problem.sensor.readings.with_values(rates=rates)
    stepped = with_readings(problem, readings)
    found = split_halves(estimate_of(stepped, KalmanFilter().fit(stepped)))
    d = problem.layout["gyro_offset"]
    change = found.difference[d] - steady.difference[d]
    np.testing.assert_allclose(change, -step, atol=float(found.deviation[d].max()))
    assert found.worst()[0].startswith("gyroscope.offset")


def test_groups_whose_halves_disagree_become_as_uncertain_as_they_show():
    problem, run = small_problem(), small_run()
    n = len(problem.parameter_names)
    score = np.full(n, 1.0)
    score[problem.layout["accel_offset"]] = [3.0, -4.0, 5.0]
    score[problem.layout["gyro_offset"]] = [1.9, -1.9, 1.9]  # below two: chance
    score[problem.layout["time_offset"]] = 50.0  # no sensor's
    found = estimate_of(problem, run)
    after = with_disagreement(found, SplitHalves(problem.parameter_names, score, np.ones(n)))
    ratio = after.deviation / run.belief.standard_deviation
    want = np.ones(problem.layout.degrees)
    want[problem.layout["accel_offset"]] = (50.0 / 3.0) ** 0.5
    np.testing.assert_allclose(ratio, want, rtol=1e-9)
    # an independent error: how other parameters act on the group does not change
    expected, d = run.belief.covariance.copy(), problem.layout["accel_offset"]
    expected[d, d] *= 50.0 / 3.0
    size = np.outer(after.deviation, after.deviation)
    np.testing.assert_allclose(after.belief.covariance / size, expected / size, atol=1e-9)
    assert [w.subject for w in after.warnings] == ["halves"]
    assert after.warnings[0].message.endswith("accel_offset 4.1")


def test_halves_that_agree_or_were_not_compared_change_nothing():
    problem = small_problem()
    n = len(problem.parameter_names)
    found = estimate_of(problem, small_run())
    assert halves_disagreement(found, None) == Disagreement()
    agree = SplitHalves(problem.parameter_names, np.full(n, 1.9), np.ones(n))
    assert halves_disagreement(found, agree) == Disagreement()


def test_halves_of_a_device_with_drifts_widen_the_groups_that_differ():
    """Halves have no drifts: scores belong to the groups of the estimate of what lasts."""
    problem = with_drifts(camera_problem(), GaussMarkov(1e-4, 8.0))
    found = without_passing(estimate_of(problem, KalmanFilter().fit(problem)))
    score = np.zeros(len(found.problem.parameter_names))
    score[found.problem.layout["accel_offset"]] = 5.0
    halves = SplitHalves(found.problem.parameter_names, score, np.ones(score.size))
    widened = with_disagreement(found, halves).deviation
    scale = widened / found.run.belief.standard_deviation
    np.testing.assert_allclose(scale[found.problem.layout["accel_offset"]], 5.0, rtol=1e-9)
    np.testing.assert_allclose(np.delete(scale, np.r_[found.problem.layout["accel_offset"]]), 1.0, rtol=1e-9)
    assert halves.names == split_halves(estimate_of(problem, KalmanFilter().fit(problem))).names

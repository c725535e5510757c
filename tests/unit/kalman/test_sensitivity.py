"""Terms outside the state, against runs over data that contain them."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.fitting.partition import block_ends
from kreisel.fitting.terms import Terms
from kreisel.geometry.rotation import exp, multiply
from kreisel.kalman import filter_pass
from kreisel.kalman import scores as scores_module
from kreisel.kalman.elimination import Elimination
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.kalman.kernel_inputs import filter_record
from kreisel.kalman.linear_run import LinearRun
from kreisel.kalman.prior_exchange import narrowed_belief, start_near
from kreisel.kalman.run_slopes import Slopes
from kreisel.kalman.sensitivity import Sensitivity
from kreisel.model.problem import with_correlation_time, with_readings

from ...small_problem import camera_problem

ESTIMATOR = KalmanFilter()


def functions():
    """One slow function of time for readings and one for poses; with its mean over updates, and at poses."""
    problem = camera_problem()
    t, tau = problem.sensor.readings.stamps, problem.reference.seconds
    of_readings, of_poses = np.cos(0.4 * t), 1.0 - np.cos(0.3 * tau)  # navigation starts from the first poses
    updates = problem.schedule.updates
    sums = np.append(0.0, np.cumsum(0.5 * (of_readings[1:] + of_readings[:-1])))
    mean = [(sums[u.last] - sums[u.first]) / max(u.last - u.first, 1) for u in updates]
    return of_readings, of_poses, np.column_stack([mean, of_poses[[u.pose for u in updates]]])


def terms():
    """A term for each component of readings and poses, and one along a direction of poses."""
    problem = camera_problem()
    count = len(problem.schedule.updates)
    directions = np.concatenate([np.broadcast_to(np.eye(6), (count, 6, 6)), np.full((count, 6, 1), 0.5)], axis=2)
    row = np.arange(13)
    return Terms(functions()[2], (row >= 6).astype(np.int64), row, directions)


def with_term(problem, row, size):
    of_readings, of_poses, _ = functions()
    readings, reference = problem.sensor.readings, problem.reference
    if row < 6:
        values = [readings.rates.copy(), readings.accelerations.copy()]
        values[row // 3][:, row % 3] += size * of_readings
        changed = readings.with_values(rates=values[0], accelerations=values[1])
        return with_readings(problem, changed)
    moved = np.zeros((of_poses.size, 6))
    if row == 12:
        moved += 0.5 * size * of_poses[:, None]
    else:
        moved[:, row - 6] = size * of_poses
    return replace(
        problem,
        reference=replace(
            reference,
            positions=reference.positions + moved[:, :3],
            quaternions=multiply(reference.quaternions, exp(moved[:, 3:])),
        ),
    )


@pytest.fixture(scope="module")
def near():
    return ESTIMATOR.refit(camera_problem(), ESTIMATOR.fit(camera_problem()))


@pytest.fixture(scope="module")
def beside(near):
    problem, slopes = camera_problem(), Slopes(camera_problem())
    start, begun = start_near(problem, near), narrowed_belief(problem, near)
    run = run_filter(problem, start, belief=begun, gate=100.0, slopes=slopes)
    return run, Sensitivity(problem, terms(), slopes), start, begun


@pytest.mark.parametrize("row", range(13))
def test_derivatives_are_those_of_a_run_over_data_with_a_term(beside, row):
    problem, (run, sensitivity, start, begun) = camera_problem(), beside
    n = len(problem.parameter_names)
    deviation = run.belief.standard_deviation[:n]
    size = 0.03 / np.max(np.abs(sensitivity.state[:n, row]) / deviation)
    other = run_filter(with_term(problem, row, size), start, belief=begun, gate=100.0)
    change = problem.layout.minus(other.belief.mean[:, None], run.belief.mean)[:n, 0]
    assert np.max(np.abs(change - size * sensitivity.state[:n, row]) / deviation) < 0.03 * 0.05
    misfit = float(np.nansum(other.history.whitened**2) - np.nansum(run.history.whitened**2))
    expected = size * (size * sensitivity.information[row, row] - 2.0 * sensitivity.score[row])
    assert misfit == pytest.approx(expected, rel=0.1, abs=0.02)


@pytest.mark.parametrize("row", [0, 1, 4, 8, 10])
def test_errors_of_poses_last_where_navigation_begins_anew(near, row):
    """Coloured noise is the reference's: what the run knows of it is kept over a gap of the readings."""
    problem = with_correlation_time(camera_problem(), 3.0)
    updates = [
        update.begun_anew() if k in (60, 100, 140) else update for k, update in enumerate(problem.schedule.updates)
    ]
    problem = replace(problem, schedule=replace(problem.schedule, updates=tuple(updates)))
    slopes = Slopes(problem)
    start, begun = start_near(problem, near), narrowed_belief(problem, ESTIMATOR.refit(problem, near))
    run = run_filter(problem, start, belief=begun, gate=100.0, slopes=slopes)
    n, derivative = len(problem.parameter_names), Sensitivity(problem, terms(), slopes).state
    deviation = run.belief.standard_deviation[:n]
    size = 0.03 / np.max(np.abs(derivative[:n, row]) / deviation)
    other = run_filter(with_term(problem, row, size), start, belief=begun, gate=100.0)
    change = problem.layout.minus(other.belief.mean[:, None], run.belief.mean)[:n, 0]
    assert np.max(np.abs(change - size * derivative[:n, row]) / deviation) < 0.03 * 0.05


def test_a_run_is_the_same_with_terms_beside_it(beside):
    problem, (run, _, start, begun) = camera_problem(), beside
    plain = run_filter(problem, start, belief=begun, gate=100.0)
    np.testing.assert_array_equal(plain.belief.mean, run.belief.mean)
    np.testing.assert_array_equal(plain.belief.factor, run.belief.factor)


@pytest.mark.parametrize("field", ["transition", "design", "gain", "whitening"])
def test_slopes_have_room_for_every_update_or_for_none(beside, monkeypatch, field):
    problem, (_, _, start, begun) = camera_problem(), beside

    def short(*arguments, **options):
        record = filter_record(*arguments, **options)
        return record._replace(**{field: np.ascontiguousarray(getattr(record, field)[:, 1:])})

    monkeypatch.setattr(filter_pass, "filter_record", short)
    with pytest.raises(ValueError, match=f"{field} has the shape"):
        run_filter(problem, start, belief=begun, slopes=Slopes(problem))


@pytest.mark.parametrize("row", [0, 4, 8, 10])
def test_the_change_of_a_fit_is_that_of_a_fit_of_corrected_data(near, row):
    problem = camera_problem()
    linear = ESTIMATOR.linearise(problem, near)
    fit, found = linear.fit, linear.about(terms())
    n = len(problem.parameter_names)
    deviation = fit.belief.standard_deviation[:n]
    size = 0.03 / np.max(np.abs(found.change[:, row]) / deviation)
    other = ESTIMATOR.refit(with_term(problem, row, size), near, gate=100.0)
    change = problem.layout.minus(other.belief.mean[:, None], fit.belief.mean)[:n, 0]
    assert np.max(np.abs(change - size * found.change[:, row]) / deviation) < 0.03 * 0.05


def test_the_evidence_is_that_of_the_same_terms_in_the_state(near):
    """An offset of the gyros is one parameter more: what data say of it, all others estimated, is in its covariance."""
    problem = camera_problem()
    constant = Terms(
        np.ones((len(problem.schedule.updates), 1)), np.zeros(3, dtype=np.int64), np.arange(3), terms().directions
    )
    found = ESTIMATOR.linearise(problem, near).about(constant)
    part = problem.layout["gyro_offset"]
    # a second offset can't be told from the first but by the first one's prior
    prior = problem.prior.covariance["gyro_offset"]
    run = ESTIMATOR.refit(problem, near, gate=100.0)
    own = np.linalg.inv(run.belief.covariance[part, part]) - np.linalg.inv(prior)
    np.testing.assert_allclose(found.information, np.linalg.inv(np.linalg.inv(own) + prior), rtol=0.05)


def test_scores_by_adjoint_are_those_carried_along(near):
    linear = ESTIMATOR.linearise(camera_problem(), near)
    found, scores = linear.about(terms()), linear.scores(terms())
    np.testing.assert_allclose(scores.value, found.score, rtol=1e-6, atol=1e-6 * np.abs(found.score).max())


def test_drawn_scores_are_as_large_as_the_information_says(near, monkeypatch):
    monkeypatch.setattr(scores_module, "DRAWS", 2000)
    linear = ESTIMATOR.linearise(camera_problem(), near)
    found, scores = linear.about(terms()), linear.scores(terms())
    scale = np.sqrt(np.diag(found.information))
    expected = found.information / np.outer(scale, scale)
    np.testing.assert_allclose(np.cov((scores.draws / scale).T), expected, atol=0.12)
    assert np.abs(scores.draws.mean(axis=0) / scale).max() < 4.0 / 2000**0.5


def test_steps_are_drawn_as_wide_as_what_the_prior_adds():
    """From a run that ends where it began, a step is what the stated prior pulls by, and its variance is known."""
    known = Elimination(
        np.ones(2), np.diag([1.0, 4.0]), np.diag([1.0, 0.25]), np.diag([0.5, 0.05]), np.diag([0.2, 0.1]),
        np.zeros(2), np.zeros(2),
    )  # fmt: skip
    drawn = known.drawn(np.zeros((2, 40_000)), np.random.default_rng(2))
    information, prior = np.array([0.7, 0.3]), np.array([0.2, 0.1])
    expected = (prior / information) ** 2 * (np.array([1.0, 4.0]) + 1.0 / prior)
    np.testing.assert_allclose(drawn.var(axis=1), expected, rtol=0.05)


def test_blocks_of_a_linearisation_are_those_of_a_run_for_them(near):
    problem = camera_problem()
    linear: LinearRun
    linear, alone = ESTIMATOR.linearise(problem, near), ESTIMATOR.blocks(problem, near, block_ends(problem))
    np.testing.assert_array_equal(linear.blocks.ends, alone.ends)
    np.testing.assert_allclose(linear.blocks.score, alone.score, rtol=1e-9)

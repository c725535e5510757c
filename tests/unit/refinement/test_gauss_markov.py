"""Passing changes of offsets in the filter: against closed forms and limits."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.assumed_noise import GaussMarkov
from kreisel.model.problem import without_groups
from kreisel.refinement.estimate import without_passing

from ...small_problem import camera_problem, estimate_of, small_problem, with_drifts, with_noise

SIZE = 1e-4


def moving(drift):
    return with_drifts(camera_problem(), drift)


@pytest.mark.parametrize("begun", [0.0, 0.5, 1.0])
def test_without_measurements_the_deviation_approaches_its_size(begun):
    """sigma^2 + (s^2 - sigma^2) exp(-2 t / tau), with every update rejected."""
    problem = moving(GaussMarkov(SIZE, 8.0))
    belief = first_belief(problem, problem.prior.start)
    d = problem.layout["gyro_gauss_markov"]
    mean, factor = belief.mean.copy(), belief.factor.copy()
    factor[d, d] = max(begun * SIZE, 1e-12) * np.eye(3)
    mean[problem.layout.stored("gyro_gauss_markov")] = 2.0 * SIZE
    history = run_filter(problem, problem.prior.start, belief=Belief(mean, factor), gate=0.0).history
    assert not history.used.any()
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    t = np.cumsum([stamps[u.last] - stamps[u.first] for u in updates])[:, None]
    expected = SIZE * np.sqrt(1.0 + (begun**2 - 1.0) * np.exp(-2.0 * t / 8.0))
    np.testing.assert_allclose(history.deviations[:, d], expected * np.ones(3), rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose(history.parameters[:, d], 2.0 * SIZE * np.exp(-t / 8.0) * np.ones(3), rtol=1e-9)


def test_one_that_lasts_is_a_part_of_the_offset():
    """GaussMarkov and offset together are an offset whose prior has both variances."""
    problem = with_noise(moving(GaussMarkov(SIZE, 1e9)), rate_scatter=0.0)
    apart = KalmanFilter().fit(problem)
    covariance = dict(problem.prior.start_covariance)
    covariance["gyro_offset"] = covariance["gyro_offset"] + SIZE**2 * np.eye(3)
    stated = dict(problem.prior.covariance)
    stated["gyro_offset"] = stated["gyro_offset"] + SIZE**2 * np.eye(3)
    prior = replace(problem.prior, start_covariance=covariance, covariance=stated)
    one = KalmanFilter().fit(replace(without_groups(problem, ("gyro_gauss_markov",)), prior=prior))
    offset, drift = problem.layout["gyro_offset"], problem.layout["gyro_gauss_markov"]
    P = apart.belief.covariance
    summed = P[offset, offset] + P[offset, drift] + P[drift, offset] + P[drift, drift]
    own = one.belief.covariance[offset, offset]
    np.testing.assert_allclose(np.sqrt(np.diag(summed)), np.sqrt(np.diag(own)), rtol=1e-3)
    x, y = (belief.mean[problem.layout.stored("gyro_offset")] for belief in (apart.belief, one.belief))
    x = x + apart.belief.mean[problem.layout.stored("gyro_gauss_markov")]
    np.testing.assert_allclose(x, y, rtol=0, atol=5e-3 * np.sqrt(own.max()))


def test_a_further_pass_begins_without_what_has_passed():
    problem = moving(GaussMarkov(SIZE, 8.0))
    first = KalmanFilter().fit(problem)
    assert np.abs(first.parameters.stored("gyro_gauss_markov")).max() > 0.0
    again = KalmanFilter().refit(problem, first)
    np.testing.assert_array_equal(again.start.stored("gyro_gauss_markov"), 0.0)
    sd = first.belief.standard_deviation[problem.lasting]
    change = problem.layout.minus(again.belief.mean[:, None], first.belief.mean)[problem.lasting, 0]
    assert np.abs(change / sd).max() < 0.3


def test_the_result_is_the_marginal_distribution_of_what_lasts():
    problem = moving(GaussMarkov(SIZE, 8.0))
    run = KalmanFilter().fit(problem)
    found = without_passing(estimate_of(problem, run))
    assert found.problem.parameter_names == tuple(problem.parameter_names[i] for i in problem.lasting)
    P = run.belief.covariance
    n = problem.layout.degrees
    kept = np.setdiff1d(np.arange(n), np.r_[problem.layout["gyro_gauss_markov"]])
    np.testing.assert_allclose(found.run.belief.covariance, P[np.ix_(kept, kept)], rtol=0, atol=1e-12 * P.max())
    assert found.run.history.parameters.shape[1] == problem.lasting.size
    np.testing.assert_array_equal(found.run.parameters.stored("gyro_gauss_markov"), 0.0)
    plain = estimate_of(small_problem(), run)
    assert without_passing(plain) is plain

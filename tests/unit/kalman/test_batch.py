"""The most likely states of all updates, against the same least squares written out whole."""

from dataclasses import replace

import numpy as np

from kreisel.kalman.batch import Batch, smoothed, varying
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.kalman.run_slopes import Slopes

from ...small_problem import camera_problem, small_problem, with_noise


def linearised(problem):
    """Return a run about the filter's own states, with all that a smoother needs."""
    fit = KalmanFilter().fit(problem)
    slopes = Slopes(problem, varying(problem))
    run = run_filter(problem, fit.start, belief=fit.begun, gate=np.inf, slopes=slopes, points="derivatives")
    return run, slopes


def by_smoothing_of_neighbours(problem, slopes):
    """Return the most likely changes (u, n) against the means before updates, by Rauch, Tung and Striebel.

    From whole covariances before and after each update, which the filter does not keep: they are computed here again.
    """
    n, moving = problem.layout.degrees, slice(-problem.changing, None)
    (run,) = slopes.stretches()
    before, (transition, design, gains, keep) = run.covariance, run.tables
    out = np.zeros((slopes.count, n))
    later = np.zeros(n)
    for i in reversed(range(slopes.count)):
        P = before[i]
        gain = gains[i]
        F = np.eye(n)
        F[moving] = transition[i]
        H = design[i]
        own = P @ H.T @ run.innovations[i]
        if i + 1 < slopes.count:
            after = before[i + 1]
            cross = P @ (F - gain.T @ H).T * keep[i + 1]
            own = own + cross @ np.linalg.pinv(after, rcond=1e-13, hermitian=True) @ later
        out[i], later = own, own
    return out


def test_states_are_those_of_another_smoother():
    """Walking offsets, a reference's error anew at each standstill, and navigation that begins once."""
    problem = with_noise(small_problem(), offset_walk={"gyro_offset": 1e-4, "accel_offset": 1e-4})
    layout = problem.layout
    fit = KalmanFilter().fit(problem)
    slopes = Slopes(problem, np.arange(layout.degrees))
    run = run_filter(problem, fit.start, belief=fit.begun, gate=np.inf, slopes=slopes, points="derivatives")
    found = smoothed(problem, run, slopes)
    wanted = by_smoothing_of_neighbours(problem, slopes)
    (whole,) = slopes.stretches()
    means, spread = whole.mean, whole.covariance
    changes = varying(problem)
    worst = 0.0
    for i, mean in enumerate(means):
        got = layout.minus(found[i][:, None], mean)[:, 0]
        sd = np.sqrt(np.maximum(np.diag(spread[i]), 1e-300))
        worst = max(worst, float(np.abs((got - wanted[i]) / sd)[changes].max()))
    assert worst < 1e-3


def test_a_fit_is_where_another_iteration_does_not_move():
    problem, batch = camera_problem(), Batch()
    fit = batch.fit(problem)
    n = len(problem.parameter_names)
    again = batch.refit(problem, fit)
    moved = problem.layout.minus(again.belief.mean[:, None], fit.belief.mean)[:n, 0]
    assert np.abs(moved / fit.belief.standard_deviation[:n]).max() < 0.02
    assert fit.about is not None
    assert fit.about.shape == (len(problem.schedule.updates), problem.layout.size)


def test_it_agrees_with_the_filter_where_the_motion_is_rich():
    problem = camera_problem()
    filtered = KalmanFilter().refit(problem, KalmanFilter().fit(problem))
    fit = Batch().fit(problem)
    n = len(problem.parameter_names)
    sd = filtered.belief.standard_deviation[:n]
    moved = problem.layout.minus(fit.belief.mean[:, None], filtered.belief.mean)[:n, 0]
    assert np.abs(moved / sd).max() < 0.1
    np.testing.assert_allclose(fit.belief.standard_deviation[:n], sd, rtol=0.02)


def test_states_of_another_schedule_are_not_used():
    problem, batch = camera_problem(), Batch()
    fit = batch.fit(problem)
    shifted = replace(fit, history=replace(fit.history, seconds=fit.history.seconds + 0.01))
    by_parameters, by_states = batch.refit(problem, shifted), batch.refit(problem, fit)
    np.testing.assert_allclose(by_parameters.belief.standard_deviation, by_states.belief.standard_deviation, rtol=1e-3)

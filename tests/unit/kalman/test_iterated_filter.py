"""The iterated filter's update, against Gauss and Newton's method written out about whole covariances."""

import numpy as np

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.estimation.sigma_points import DERIVATIVES, ITERATED
from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.run_slopes import Slopes
from kreisel.model.problem import part_of
from kreisel.study.methods import wrong_by

from ...small_problem import camera_problem

AT, ANGLE = 60, 0.4
"""Number of an update in fast motion, and deviation of the first mount's error, rad."""


def far_away():
    """Return a problem of two updates, navigation beginning at the first, with matrices far off, and the belief."""
    problem = part_of(camera_problem(), slice(AT, AT + 2))
    problem = wrong_by(problem, ANGLE, 0.1, np.random.default_rng(4))
    return problem, first_belief(problem, problem.prior.start)


def by_gauss_newton(problem, begun, iterations):
    """Return the belief after an update, linearised anew about what it makes of the state before it."""
    layout, about = problem.layout, None
    for _ in range(iterations):
        slopes = Slopes(problem, np.arange(layout.degrees))
        run = run_filter(
            problem, problem.prior.start, belief=begun, gate=np.inf, slopes=slopes, points=DERIVATIVES, about=about
        )
        (both,) = slopes.stretches()
        begin, mean = both.mean
        change = both.covariance[1] @ both.tables.design[1].T @ both.innovations[1]
        about = np.stack([begin, layout.plus(mean, change[:, None])[:, 0]])
    return run.belief


def distance(problem, one, other):
    moved = problem.layout.minus(one.mean[:, None], other.mean)[:, 0]
    return float(np.abs(moved / other.standard_deviation).max())


def test_an_update_is_that_of_gauss_and_newton():
    problem, begun = far_away()
    run = run_filter(problem, problem.prior.start, belief=begun, gate=np.inf, points=ITERATED)
    wanted = by_gauss_newton(problem, begun, 8)
    once = run_filter(problem, problem.prior.start, belief=begun, gate=np.inf, points=DERIVATIVES)
    assert distance(problem, run.belief, wanted) < 0.02
    assert distance(problem, once.belief, wanted) > 0.1  # else the test would see nothing
    np.testing.assert_allclose(run.belief.standard_deviation, wanted.standard_deviation, rtol=0.02)


def test_it_ends_where_the_plain_one_does_near_the_estimate():
    problem = camera_problem()
    ekf, iekf = (ESTIMATORS[name] for name in ("ekf", "iekf"))
    near = ekf.fit(problem)
    n = len(problem.parameter_names)
    one, other = (fit.belief for fit in (ekf.refit(problem, near), iekf.refit(problem, near)))
    moved = problem.layout.minus(one.mean[:, None], other.mean)[:n, 0]
    assert np.abs(moved / other.standard_deviation[:n]).max() < 0.1

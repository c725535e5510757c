"""The models' derivatives, against central differences of the models that sigma points go through."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.estimation.sigma_points import DERIVATIVES
from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.kalman.run_slopes import Slopes
from kreisel.model.problem import with_correlation_time, with_groups

from ...small_problem import camera_problem, small_problem

EFFECTS = (
    "gyro_g_sensitivity", "gyro_axis_delay", "gyro_axis_smoothing", "gyro_asymmetry", "gyro_polynomial", "accel_delay",
    "accel_asymmetry", "accel_polynomial",
)  # fmt: skip
STEP = 1e-3
"""Of the differences, in deviations of the prior: the third order is a millionth, and rounding 1e-13 over it."""


def positions_only(problem):
    """Return a problem without orientations, whose first attitude is known: both then follow one path."""
    reference = replace(problem.reference, quaternions=None)
    return replace(problem, reference=reference, schedule=replace(problem.schedule, attitude_sd=1e-3))


PROBLEMS = {
    "cameras": camera_problem,
    "poses": small_problem,
    "error terms": lambda: with_groups(small_problem(), EFFECTS),
    "coloured noise": lambda: with_correlation_time(small_problem(), 1.5),
    "errors of poses": lambda: with_groups(
        camera_problem(), ("position_scale", "position_heading", "reference_smoothing")
    ),
    "elastic mount": lambda: with_groups(camera_problem(), ("mount_bending", "mount_deflection")),
    "positions": lambda: positions_only(camera_problem()),
}


def slopes_by(problem, points):
    fit = KalmanFilter().fit(problem)
    belief = first_belief(problem, fit.parameters)
    slopes = Slopes(problem)
    narrow = Belief(belief.mean, STEP * belief.factor)
    run = run_filter(problem, fit.parameters, belief=narrow, gate=np.inf, slopes=slopes, points=points)
    return slopes, run


@pytest.mark.parametrize("name", PROBLEMS)
def test_derivatives_are_those_of_the_models(name):
    """Of each column, what moves and what is measured; largest difference over the column's largest value anywhere."""
    problem = PROBLEMS[name]()
    (by_points, first), (exact, second) = (slopes_by(problem, points) for points in ("linear", DERIVATIVES))
    (own,), (other,) = by_points.stretches(), exact.stretches()
    for x, y in ((own.tables.transition, other.tables.transition), (own.tables.design, other.tables.design)):
        size = np.abs(y).max(axis=(0, 1))
        difference = np.abs(x - y).max(axis=(0, 1))
        seen = size > 1e-6 * size.max()  # differences have no digits left of what is smaller
        assert (difference[seen] / size[seen]).max() < 1e-3
        assert seen.sum() > problem.layout.degrees / 3
    deviation = first.belief.standard_deviation
    moved = problem.layout.minus(second.belief.mean[:, None], first.belief.mean)[:, 0]
    assert np.abs(moved / deviation).max() < 1e-3  # by rounding of differences: 1e-5 to 3e-4 for starts 1e-13 apart
    np.testing.assert_allclose(second.belief.standard_deviation, deviation, rtol=1e-6)
    np.testing.assert_allclose(second.history.nis, first.history.nis, rtol=1e-5)


def test_the_size_effect_as_it_is_printed_has_derivatives():
    problem = camera_problem()
    settings = type(problem.settings)(size_effect="fox2005")
    (_, first), (_, second) = (
        slopes_by(replace(problem, settings=settings), points) for points in ("linear", DERIVATIVES)
    )
    np.testing.assert_allclose(second.belief.standard_deviation, first.belief.standard_deviation, rtol=1e-6)
    np.testing.assert_allclose(second.history.nis, first.history.nis, rtol=1e-5)

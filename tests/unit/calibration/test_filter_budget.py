"""Where the variance comes from: shares that sum to it, and what each source adds, by other means."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.filter_budget import budget_of, filter_parts
from kreisel.calibration.result_document import from_document, to_document
from kreisel.estimation.uncertainty import Contribution, scaling
from kreisel.estimation.uncertainty_budget import Source
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import with_readings

from ...small_problem import calibrated, camera_problem, estimate_of, small_problem, small_run, with_noise


@pytest.fixture(scope="module")
def parts():
    return filter_parts(estimate_of(small_problem(), small_run()))


def test_all_sources_together_are_the_variance():
    """Of a whole calibration, to rounding; the filter's own part and every contribution."""
    outcome = calibrated()
    budget, found = outcome.calibration.budget, outcome.estimate
    n = len(budget.names)
    np.testing.assert_allclose(budget.shares.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(budget.deviation, found.deviation[:n], rtol=1e-12)
    np.testing.assert_allclose(np.sum(list(budget.by_source.values()), axis=0), 1.0, rtol=1e-12)
    causes = {one.cause: i for i, one in enumerate(found.contributions)}
    for cause, place in causes.items():
        own = budget.shares[:, list(budget.causes).index(cause)] * budget.deviation**2
        np.testing.assert_allclose(own, found.contributions[place].variance[:n], rtol=1e-9, atol=1e-30)


def test_the_sensors_noise_is_what_is_left(parts):
    """By a pass with readings assumed noisier by 5 % in variance: no step in common with the difference of the rest."""
    problem, run, step = small_problem(), small_run(), 0.05
    factor = (1.0 + step) ** 0.5
    noisier = with_readings(problem, problem.sensor.readings.with_noise(factor, factor))
    base, more = (
        KalmanFilter().refit(one, run, gate=np.inf).belief.standard_deviation ** 2 for one in (problem, noisier)
    )
    n = len(problem.parameter_names)
    share = (more[:n] / base[:n] - 1.0) / step
    np.testing.assert_allclose(share, parts[Source.SENSOR], atol=0.04)
    assert parts[Source.SENSOR].max() > 0.3


@pytest.mark.parametrize(
    ("source", "kinds"), [(Source.PATH, ("position", "orientation")), (Source.STANDSTILL, ("standstill",))]
)
def test_the_references_noise_is_what_more_of_it_adds(parts, source, kinds):
    """By a pass with noise of one kind larger by 2 % in variance: the filter's own covariance, and no adjoint."""
    problem, run, step = small_problem(), small_run(), 0.02
    factors = dict.fromkeys(("position", "orientation", "standstill"), 1.0) | dict.fromkeys(kinds, (1.0 + step) ** 0.5)
    larger = with_noise(problem, reference=problem.noise.reference.scaled(**factors))
    base, more = (
        KalmanFilter().refit(one, run, gate=np.inf).belief.standard_deviation ** 2 for one in (problem, larger)
    )
    n = len(problem.parameter_names)
    np.testing.assert_allclose((more[:n] / base[:n] - 1.0) / step, parts[source], atol=2e-3)


def test_gravity_and_the_robots_errors_come_from_what_is_stated(parts):
    problem = small_problem()
    gravity = problem.layout["gravity"]
    assert parts[Source.PRIOR][gravity] > 0.9
    np.testing.assert_allclose(np.sum(list(parts.values()), axis=0), 1.0, rtol=1e-12)
    assert all((share >= 0.0).all() for share in parts.values())


def test_a_pose_error_of_the_arm_is_the_robots(parts):
    problem = small_problem()
    own, d = problem.noise.pose_error, problem.layout["lever_arms"]
    larger = replace(own, position=2.0 * own.position, orientation=2.0 * own.orientation)
    double = filter_parts(estimate_of(with_noise(problem, pose_error=larger), small_run()))
    assert double[Source.ROBOT][d].mean() > parts[Source.ROBOT][d].mean() + 0.05
    cameras = camera_problem()
    assert Source.ROBOT not in filter_parts(estimate_of(cameras, KalmanFilter().fit(cameras)))


def test_contributions_take_their_share(parts):
    problem, run = small_problem(), small_run()
    column = np.zeros((problem.layout.degrees, 1))
    d = problem.layout["gyro_offset"]
    column[d.start] = 2.0 * run.belief.standard_deviation[d.start]
    found = estimate_of(problem, run).adding([
        scaling("correlated innovations", Source.PATH, run.belief.factor, 2.0**0.5),
        Contribution("walk", Source.SENSOR, column),
    ])  # fmt: skip
    budget = budget_of(found, parts)
    causes = list(budget.causes)
    assert budget.shares[d.start, causes.index("walk")] == pytest.approx(4.0 / 6.0)
    assert budget.shares[d.start, causes.index("correlated innovations")] == pytest.approx(1.0 / 6.0)
    assert budget.shares[d.start + 1, causes.index("correlated innovations")] == pytest.approx(0.5)
    whole = budget.by_source[Source.SENSOR][d.start]
    assert whole == pytest.approx(4.0 / 6.0 + parts[Source.SENSOR][d.start] / 6.0)


def test_the_document_keeps_it_to_a_thousandth_of_a_per_cent():
    calibration = calibrated().calibration
    again = from_document(to_document(calibration)).budget
    assert again.names == calibration.budget.names
    assert again.causes == calibration.budget.causes
    np.testing.assert_allclose(again.shares, calibration.budget.shares, atol=1e-5)
    np.testing.assert_allclose(again.deviation, calibration.budget.deviation, rtol=1e-5)

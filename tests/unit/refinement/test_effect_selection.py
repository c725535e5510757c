"""Evidence of effects by conditioning, against the likelihood that the filter itself gives with and without them."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.fitting.stored_state import first_belief
from kreisel.inertial.effects import OF_TEMPERATURE
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import with_groups, with_readings
from kreisel.refinement import effect_selection
from kreisel.refinement.effect_selection import _kept_mean, candidates, selected, survey

from ...small_problem import camera_problem, small_problem


@pytest.fixture(scope="module")
def found():
    problem = small_problem()
    run = KalmanFilter().refit(problem, KalmanFilter().fit(problem))
    estimator = KalmanFilter()
    return survey(problem, run, lambda: estimator.linearise(problem, run), estimator)


def filtered(problem, groups):
    """Return a run of the filter with groups in the state, from the start's covariance and the groups' priors."""
    larger = with_groups(problem, groups, {g: effect_selection.usual_covariance(g, problem) for g in groups})
    order = larger.settings.polynomial_order
    start = larger.prior.start.with_order(order)
    return larger, run_filter(larger, start, belief=first_belief(larger, start), gate=np.inf)


@pytest.mark.parametrize(
    "groups",
    [
        ("accel_delay",),
        ("gyro_asymmetry",),
        ("accel_smoothing",),
        ("accel_delay", "accel_asymmetry"),
        ("gyro_polynomial",),
    ],
)
def test_gain_is_the_difference_of_log_likelihoods(found, groups):
    """The likelihood of all innovations with an effect is the evidence, the mean over the effect's prior.

    The two begin at other points, and the model is not quite linear: a twentieth of the gain, or a third of a unit.
    """
    problem = found.before
    plain = filtered(problem, ())[1].history.log_likelihood.sum()
    with_effect = filtered(problem, groups)[1].history.log_likelihood.sum()
    gain = replace(found, temper=1.0).gain(groups)
    assert gain == pytest.approx(with_effect - plain, rel=0.05, abs=0.3)


@pytest.mark.parametrize("groups", [("accel_delay",), ("gyro_asymmetry", "accel_smoothing")])
def test_the_others_held_at_zero_the_result_is_that_of_the_smaller_model(found, groups):
    problem, run = found.conditioned(groups)
    again = KalmanFilter().refit(problem, run)
    n = len(problem.parameter_names)
    change = problem.layout.minus(again.belief.mean[:, None], run.belief.mean)[:n, 0]
    assert np.abs(change / again.belief.standard_deviation[:n]).max() < 0.1
    ratio = run.belief.standard_deviation[:n] / again.belief.standard_deviation[:n]
    # curvature changes within an update, while the axes turn: that of the smoothing is a twelfth off
    curved = np.array([name == "accelerometer.smoothing" for name in problem.parameter_names])
    assert np.abs(ratio - 1.0)[~curved].max() < 0.05
    assert np.abs(ratio - 1.0)[curved].max(initial=0.0) < 0.085


@pytest.mark.parametrize("left", [0, 1, 2])
def test_what_is_lost_without_a_candidate_is_the_difference_of_gains(found, left):
    chosen = found.groups[left:]
    lost = found.lost(chosen)
    for group in chosen:
        others = tuple(other for other in chosen if other != group)
        assert lost[group] == pytest.approx(found.gain(chosen) - found.gain(others), rel=1e-6, abs=1e-6)


def test_clean_data_show_nothing_and_large_effects_are_never_dropped(found):
    assert selected(found) == ()
    assert selected(found, threshold=-np.inf) == found.groups


def test_what_is_in_the_state_or_fixed_is_no_candidate():
    problem = small_problem()
    assert "accel_delay" in candidates(problem)
    assert "accel_delay" not in candidates(with_groups(problem, ("accel_delay",)))
    settings = replace(problem.settings, fixed=("accel_delay",))
    assert "accel_delay" not in candidates(replace(problem, settings=settings))
    blind = replace(problem, reference=replace(problem.reference, positions=None))
    assert not {g for g in candidates(blind) if g.startswith("accel") or g == "position_scale"}


def test_undecided_effects_widen_by_little_where_they_gain_nothing(found):
    columns = found.undecided()
    P = found.before
    added = np.sum(columns**2, axis=1)[: len(P.parameter_names)]
    variance = np.diag(found.conditioned(())[1].belief.covariance)[: added.size]
    assert (added >= 0.0).all()
    assert (added / variance).max() < 0.3


def test_a_new_effect_leaves_the_mean_of_the_readings_as_it_was():
    """Offset and effect together: drawn from the changed belief, they add nothing on average."""
    problem = with_groups(camera_problem(), ("gyro_g_sensitivity", "accel_asymmetry"))
    T = _kept_mean(problem, ("gyro_g_sensitivity", "accel_asymmetry"))
    layout, readings = problem.layout, problem.sensor.readings
    x = np.random.default_rng(4).normal(size=layout.degrees)
    changed = T @ x - x
    np.testing.assert_array_equal(np.delete(changed, np.r_[layout["gyro_offset"], layout["accel_offset"]]), 0.0)
    G, c = x[layout["gyro_g_sensitivity"]].reshape(3, 3), x[layout["accel_asymmetry"]]
    np.testing.assert_allclose(changed[layout["gyro_offset"]], -G @ readings.accelerations.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(changed[layout["accel_offset"]], -c * np.abs(readings.accelerations).mean(axis=0))


def test_what_is_rare_or_needs_a_thermometer_is_looked_for_only_then():
    problem = camera_problem()
    assert not {"gyro_g_squared", *OF_TEMPERATURE} & {*candidates(problem)}
    expecting = replace(problem, prior=replace(problem.prior, expected=("gyro_g_squared",)))
    assert "gyro_g_squared" in candidates(expecting)
    for rise, there in ((0.4, False), (2.0, True)):
        temperature_difference = np.linspace(0.0, rise, problem.sensor.readings.stamps.size)
        measured = with_readings(
            problem, replace(problem.sensor.readings, temperature_difference=temperature_difference)
        )
        assert ({*OF_TEMPERATURE} <= {*candidates(measured)}) == there

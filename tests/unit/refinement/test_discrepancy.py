"""Errors that are on no list, in the readings and poses of a small cell: found, taken out, and counted."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kreisel.fitting.terms import Terms
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import with_readings
from kreisel.refinement.discrepancy import _parts_of_degree, describe
from kreisel.refinement.iteration import estimate
from kreisel.refinement.noise_adaptation import StatedFigures

from ...small_problem import camera_problem, recorded

SIZE = 4e-3
"""rad/s."""

REMAINDER = "remainder of the model discrepancy"

STATED = StatedFigures(reference=True, imu=True)


def with_gyro_error(problem, size):
    """An error of one gyro that depends on the acceleration of two axes, less what the usual model has of it."""
    readings = problem.sensor.readings
    w, f = readings.rates, readings.accelerations
    error = np.tanh(f[:, 0] / 4.0) * np.cos(f[:, 1] / 3.0)
    products = np.stack([w[:, i] * w[:, k] for i in range(3) for k in range(i, 3)], axis=1)
    usual = np.hstack([np.ones((len(w), 1)), w, f, np.gradient(w, readings.stamps, axis=0), products])
    error -= usual @ np.linalg.lstsq(usual, error, rcond=None)[0]
    rates = w.copy()
    rates[:, 2] += size * error / error.std()
    return with_readings(problem, readings.with_values(rates=rates))


@cache
def found(size):
    return estimate(with_gyro_error(camera_problem(), size), STATED, KalmanFilter())


def scores(outcome):
    """Return errors of the gyros' matrix over their deviations."""
    error = (outcome.run.parameters.sensors.K_omega - recorded()[0].sensors.K_omega).ravel()
    return error / outcome.deviation[outcome.problem.layout["gyro_cross_coupling"]]


def test_a_clean_recording_has_none_and_keeps_its_deviations():
    assert found(0.0).discrepancy == ()
    causes = {one.cause: one for one in found(0.0).contributions}
    undecided = causes.get("undecided model discrepancy")
    n = len(found(0.0).problem.parameter_names)
    if undecided is not None:
        assert np.all(undecided.variance[:n] < 0.1 * found(0.0).run.belief.standard_deviation[:n] ** 2)


def test_an_error_by_acceleration_is_found_as_one_and_taken_out():
    largest = max(found(SIZE).discrepancy, key=lambda one: one.gain)
    assert largest.family.name == "gyroscope.acceleration"
    assert 0.5 * SIZE / 3**0.5 < largest.size < 1.2 * SIZE / 3**0.5  # of three axes, one errs
    assert "gyros by acceleration" in describe(largest)
    assert any(warning.subject == "discrepancy" for warning in found(SIZE).warnings)
    corrected = found(SIZE).problem.sensor.readings.rates
    assert not np.array_equal(corrected, with_gyro_error(camera_problem(), SIZE).sensor.readings.rates)


def test_offsets_of_gyros_at_rest_may_be_those_of_the_whole_less_what_terms_add_there():
    outcome = found(SIZE)
    layout, groups = (
        outcome.problem.layout,
        [one for one in outcome.contributions if one.cause.startswith("attribution")],
    )
    readings, recorded_at = outcome.problem.sensor.readings, outcome.stated.sensor.readings
    resting = np.zeros(readings.stamps.size, dtype=bool)
    for standstill in outcome.problem.schedule.standstills:
        resting |= (readings.stamps >= standstill.start) & (readings.stamps <= standstill.stop)
    added = (readings.rates - recorded_at.rates)[resting].mean(axis=0)
    (attribution,) = groups
    assert np.abs(added).max() > 1e-5
    assert np.all(attribution.variance[layout["gyro_offset"]] >= (0.49 * added) ** 2)


def test_results_are_right_with_it():
    assert np.abs(scores(found(SIZE))).max() < 4.0


def test_what_terms_leave_uncertain_is_a_contribution():
    one = next(one for one in found(SIZE).contributions if one.cause == "model discrepancy")
    part = found(SIZE).problem.layout["gyro_cross_coupling"]
    assert np.all(one.variance[part] > 0.0)
    total = found(SIZE).run.belief.standard_deviation[part] ** 2 + sum(
        each.variance[part] for each in found(SIZE).contributions
    )
    np.testing.assert_allclose(total, found(SIZE).deviation[part] ** 2, rtol=1e-12)


def test_what_the_series_leave_out_is_a_contribution():
    """The next degree falls as the last one: its effect is far below the error itself."""
    assert all(one.cause != REMAINDER for one in found(0.0).contributions)
    outcome = found(SIZE)
    (own,) = (one for one in outcome.contributions if one.cause == REMAINDER)
    part = outcome.problem.layout["gyro_cross_coupling"]
    deviation = np.sqrt(own.variance[part])
    assert np.all(deviation > 0.0)
    assert np.median(deviation) < 0.2 * SIZE  # of a rate of about one


def test_what_was_recorded_is_kept():
    given, kept = with_gyro_error(camera_problem(), SIZE), found(SIZE).recorded
    np.testing.assert_array_equal(kept.sensor.readings.rates, given.sensor.readings.rates)
    np.testing.assert_array_equal(kept.reference.positions, given.reference.positions)
    assert kept.layout is found(SIZE).problem.layout
    assert found(0.0).recorded is found(0.0).problem


def test_a_fixed_number_of_passes_looks_for_nothing():
    problem = with_gyro_error(camera_problem(), SIZE)
    fixed = replace(problem, settings=replace(problem.settings, passes=2))
    assert estimate(fixed, STATED, KalmanFilter()).discrepancy == ()


@pytest.mark.parametrize("size", [0.0, SIZE])
def test_the_schedule_is_that_of_the_recording(size):
    assert len(found(size).problem.schedule.updates) == len(camera_problem().schedule.updates)


def test_functions_of_a_degree_that_depend_on_each_other_count_as_the_functions_they_span():
    """All functions of a span together have an rms of one; one that stands there twice changes nothing."""
    rng = np.random.default_rng(5)
    values = rng.normal(size=(400, 3))
    twice = np.hstack([values, values[:, :1] + 1e-9 * values[:, 1:2]])
    change = rng.normal(size=(7, 3))
    spread = []
    for functions in (values, twice):
        k = functions.shape[1]
        columns = change if k == 3 else np.hstack([change, change[:, :1]])
        own = Terms(functions, np.tile(np.arange(k), 2), np.repeat([0, 1], k), np.zeros((400, 6, 6)))
        size, roots = _parts_of_degree(own, np.ones(2 * k))
        first = roots[:k][:, : roots.shape[1] // 2]
        assert np.mean((functions @ first) ** 2, axis=0).sum() == pytest.approx(0.5)
        assert size == pytest.approx(np.sqrt(2.0 * np.mean(functions.sum(axis=1) ** 2)))
        spread.append(np.hstack([columns, columns]) @ roots)
    np.testing.assert_allclose(spread[0] @ spread[0].T, spread[1] @ spread[1].T, rtol=1e-4)

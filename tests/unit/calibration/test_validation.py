"""What holds on unseen data: injected errors undone by the sensor model itself, drift against the noise there is."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.cross_validation import _drift, cross_validate, first_part, navigation_only
from kreisel.calibration.injection import _errors, inject
from kreisel.fitting.fit import Fit
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect, correct_angular_rate, correct_specific_force
from kreisel.kalman.filter_pass import run_filter
from kreisel.model.problem import part_of
from kreisel.units import DEG_PER_HOUR, MG

from ...navigation import corrected
from ...small_problem import calibrated, history, recorded


@pytest.mark.parametrize("form", list(SizeEffect))
def test_the_parameters_expected_undo_the_errors_injected(form):
    """Corrected readings are the same, to rounding, with and without errors, whatever the form of the size effect."""
    errors, sensors = _errors(), recorded()[0].sensors
    rng = np.random.default_rng(0)
    w, a, alpha = rng.normal(size=(30, 3)), 9.81 * rng.normal(size=(30, 3)), rng.normal(size=(30, 3))
    spoilt_w = (w + errors.gyro_offset) * (1.0 + errors.gyro_scale)
    spoilt_a = (a + errors.accel_offset) * (1.0 + errors.accel_scale)
    undone = errors.apply(sensors)
    omega = correct_angular_rate(w, sensors)
    np.testing.assert_allclose(correct_angular_rate(spoilt_w, undone), omega, atol=1e-13)
    want = correct_specific_force(a, omega, alpha, sensors, form)
    np.testing.assert_allclose(correct_specific_force(spoilt_a, omega, alpha, undone, form), want, atol=1e-12)
    assert np.abs(undone.k_a - sensors.k_a).max() > 4.0 * MG


def test_the_errors_are_those_that_are_promised():
    errors = _errors()
    np.testing.assert_allclose(errors.accel_offset / MG, [5.0, -3.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(errors.gyro_offset / DEG_PER_HOUR, [20.0, -30.0, 10.0], rtol=1e-12)
    for scale in (errors.gyro_scale, errors.accel_scale):
        np.testing.assert_allclose(scale, [2000e-6, 0.0, 0.0], rtol=1e-12)


@pytest.fixture(scope="module")
def injection():
    return inject(calibrated())


def test_injected_errors_are_found(injection):
    """The noise is the same in both calibrations; what is left is the pull of the stated priors.

    It is at most the share of the prior's information, (sd / prior sd)^2, of the offset of 30 deg/h, which is one and a
    half of the prior's deviations: for the gyros, known to 4.7 deg/h, 0.35 of their own deviations.
    """
    assert np.abs((injection.found - injection.injected) / injection.deviation).max() < 0.5
    d = calibrated().estimate.problem.layout["accel_offset"]
    np.testing.assert_allclose(injection.found[d], [-0.0498, 0.0294, -0.0392], atol=2e-4)  # 5, -3 and 4 mg undone
    assert np.abs(injection.injected[d] / injection.deviation[d]).min() > 40.0


def test_what_was_not_injected_is_expected_to_stay(injection):
    outcome = calibrated()
    assert injection.names == outcome.estimate.problem.parameter_names
    layout = outcome.estimate.problem.layout
    np.testing.assert_allclose(injection.injected[layout["lever_arms"].start :], 0.0, atol=1e-15)
    n = len(injection.names)
    np.testing.assert_array_equal(injection.deviation, outcome.estimate.deviation[:n])


@pytest.fixture(scope="module")
def crossed():
    return cross_validate(calibrated().estimate)


def test_drift_is_that_of_the_part_that_was_not_trained_on(crossed):
    problem = calibrated().estimate.problem
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    unseen = updates[first_part(problem)[0] :]
    want = [stamps[u.last] for i, u in enumerate(unseen) if i >= 2 and u.standstill is None]
    for drift in (crossed.nominal, crossed.calibrated):
        np.testing.assert_array_equal(drift.seconds, want)
        assert drift.position.shape == drift.attitude.shape == drift.seconds.shape


def test_a_calibrated_cell_drifts_by_no_more_than_the_noise(crossed):
    """The poses' own noise is 0.5 mm and 0.5 mrad an axis, 0.9 over three; navigation knows its start no better."""
    noise = 0.5e-3 * 3**0.5
    for drift, limit in ((crossed.calibrated.attitude, 1.6 * noise), (crossed.calibrated.position, 4.0 * noise)):
        assert 0.7 * noise < np.sqrt(np.mean(drift**2)) < limit


def test_a_nominal_cell_drifts_by_its_errors(crossed):
    """Cross couplings of 0.8 % turn the attitude by about that share of what b turns: a radian in two intervals."""
    nominal, known = crossed.nominal, crossed.calibrated
    assert np.sqrt(np.mean(nominal.attitude**2)) > 5.0 * np.sqrt(np.mean(known.attitude**2))
    assert np.sqrt(np.mean(nominal.position**2)) > 20.0 * np.sqrt(np.mean(known.position**2))


def test_navigation_alone_learns_nothing():
    problem = calibrated().estimate.problem
    alone = navigation_only(part_of(problem, slice(30, 60)))
    assert alone.groups == ()
    known = replace(problem.prior.start, gravity=9.8)
    run = run_filter(alone, known, gate=np.inf)
    for group in problem.groups:
        np.testing.assert_array_equal(run.parameters.stored(group), known.stored(group))
    assert run.history.used.all()


def test_drift_is_the_length_of_the_innovation_on_the_path_once_navigation_runs():
    still = np.array([False, False, False, True, False])
    innovation = np.full((5, 9), np.nan)
    innovation[:, :6] = [
        [9, 9, 9, 9, 9, 9],
        [9, 9, 9, 9, 9, 9],
        [1, 2, 2, 0, 3, 4],
        [9, 9, 9, 9, 9, 9],
        [0, 0, 5, 2, 3, 6],
    ]
    found = _drift(Fit(None, None, None, history(5, innovation=innovation, at_standstill=still)))
    np.testing.assert_array_equal(found.seconds, [2.0, 4.0])
    np.testing.assert_allclose(found.position, [3.0, 5.0])
    np.testing.assert_allclose(found.attitude, [5.0, 7.0])


@pytest.mark.parametrize("order", [1, 2, 3])
def test_parameters_undo_known_errors_at_any_order(order):
    rng = np.random.default_rng(order)
    errors = _errors()
    k = np.vstack([rng.normal(0.0, 0.1, (1, 3)), rng.normal(0.0, 0.02, (order - 1, 3))])
    p = SensorParameters(np.eye(3) + rng.normal(0.0, 0.05, (3, 3)), k, np.eye(3), k, np.zeros((3, 3)))
    old = rng.normal(0.0, 1.0, (50, 3))
    raw = (old + errors.gyro_offset) * (1.0 + errors.gyro_scale)
    t, still = np.arange(50.0), np.zeros((50, 3))
    undone, plain = (corrected(t, x, x, own, still)[0] for x, own in ((raw, errors.apply(p)), (old, p)))
    np.testing.assert_allclose(undone, plain, atol=1e-13)

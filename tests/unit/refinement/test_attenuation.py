"""Attenuation: what noise of the readings does to the matrices they are multiplied by."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.estimation.uncertainty import total
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import with_readings
from kreisel.refinement import attenuation
from kreisel.refinement.attenuation import _profile, pull_of_noise, without_attenuation

from ...small_problem import camera_problem, with_noise


def noisy_problem():
    """Poses far better than the accelerometers."""
    problem = camera_problem()
    noise = problem.noise.reference.scaled(position=0.1, orientation=1.0, standstill=0.1)
    problem = with_noise(problem, reference=noise, observed=np.full((2, 3), np.inf))
    return with_readings(problem, problem.sensor.readings.with_noise(1.0, 30.0))


@pytest.fixture(scope="module")
def weak():
    """Poses far better than the accelerometers, and matrices of which little is known."""
    problem = noisy_problem()
    run = KalmanFilter().fit(problem)
    i = problem.layout["accel_cross_coupling"]
    factor = run.belief.factor.copy()
    factor[i] *= 30.0
    return problem, replace(run, belief=Belief(run.belief.mean, factor))


def test_noise_pulls_towards_smaller_matrices(weak):
    """More noise makes K smaller; the result without it is larger, and less certain."""
    problem, run = weak
    change = pull_of_noise(problem, run, KalmanFilter())
    d = problem.layout["accel_cross_coupling"]
    K = run.parameters.stored("accel_cross_coupling")
    assert change[d] @ K < 0.0
    found, uncertainty = without_attenuation(problem, run, change)
    assert found.parameters.stored("accel_cross_coupling") @ K > K @ K
    np.testing.assert_array_equal(found.belief.factor, run.belief.factor)
    assert (uncertainty.variance[d] > 0.0).all()


def test_there_is_none_to_speak_of_with_quiet_sensors():
    problem = camera_problem()
    quiet = with_readings(problem, problem.sensor.readings.with_noise(0.1, 0.1))
    assert pull_of_noise(quiet, KalmanFilter().fit(quiet), KalmanFilter()) is None


def test_noise_that_comes_within_a_second_pulls_by_no_more_than_it_does(monkeypatch):
    """As much noise again in that second makes updates beyond the gate; their loss, by chance, is no pull of noise."""
    problem = noisy_problem()
    readings = problem.sensor.readings
    middle = np.abs(readings.stamps - readings.stamps.mean()) < 0.5
    shaken = readings.accelerations.copy()
    size = np.sqrt(readings.noise[1] / np.median(np.diff(readings.stamps)))
    shaken[middle] += size * np.random.default_rng(1).standard_normal((np.sum(middle), 3))
    problem = with_readings(problem, readings.with_values(accelerations=shaken))
    run, n = KalmanFilter().fit(problem), len(problem.parameter_names)
    found = []
    for seed in range(4):
        monkeypatch.setattr(attenuation, "_SEED", seed)
        found.append(pull_of_noise(problem, run, KalmanFilter()) / run.belief.standard_deviation[:n])
    assert np.abs(np.mean(found, axis=0)).max() < 0.3
    assert np.std(found, axis=0).max() < 0.15


@pytest.mark.parametrize(("noise", "tolerance"), [(0.01, 1e-5), (0.1, 2e-3), (0.3, 0.03)])
def test_the_slope_of_a_line_with_noise_in_both_variables(weak, noise, tolerance):
    """Least squares finds K x / (x + n) of a true K, with variances x and n, and K x / (x + 2 n) with more noise.

    The false information comes from two steps of a series: its remainder is of third order.
    """
    problem, run = weak
    d, n = problem.layout["accel_cross_coupling"], problem.layout.degrees
    signal, K = 400.0, run.parameters.stored("accel_cross_coupling")
    sd = np.full(n, 1e-3)
    sd[d] = (signal * (1.0 + noise)) ** -0.5
    mean = run.belief.mean.copy()
    mean[problem.layout.stored("accel_cross_coupling")] = K / (1.0 + noise)
    sensors = replace(run.parameters.sensors, K_a=K.reshape(3, 3) / (1.0 + noise))
    seen = replace(run, belief=Belief(mean, np.diag(sd)), parameters=replace(run.parameters, sensors=sensors))
    change = np.zeros(len(problem.parameter_names))
    change[d] = K / (1.0 + 2.0 * noise) - K / (1.0 + noise)
    found, uncertainty = without_attenuation(problem, seen, change)
    np.testing.assert_allclose(found.parameters.stored("accel_cross_coupling"), K, rtol=tolerance)
    step = K - K / (1.0 + noise)
    variance = (
        total(found.belief, [uncertainty]).standard_deviation[d] ** 2 - (0.25 * step) ** 2
    )  # how well the noise's power is known
    np.testing.assert_allclose(variance, (1.0 + noise) / signal, rtol=4.0 * tolerance)  # 1/I + F/I^2


def test_the_noise_that_is_added_is_as_large_as_that_of_the_readings_where_they_have_it():
    rng = np.random.default_rng(3)
    size = np.where(np.arange(40_000) < 20_000, 1.0, 3.0)[:, None]
    profile = _profile(size * rng.normal(size=(40_000, 3)), 200)
    np.testing.assert_allclose(profile.mean(axis=0), 1.0, rtol=1e-9)
    np.testing.assert_allclose(profile[30_000:].mean() / profile[:10_000].mean(), 9.0, rtol=0.05)

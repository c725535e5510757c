"""Attenuation: what noise of the readings does to the matrices they are multiplied by."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.filtering.attenuation import false_information, without_attenuation
from kreisel.filtering.prior_exchange import first_pass, further_pass

from ...small_problem import camera_problem, with_noise


@pytest.fixture(scope="module")
def weak():
    """Poses far better than the accelerometers, and matrices of which little is known."""
    problem = camera_problem()
    noise = problem.noise.reference.scaled(position=0.1, orientation=1.0, standstill=0.1)
    problem = with_noise(problem, reference=noise, observed=(np.inf, np.inf))
    problem = replace(problem, readings=problem.readings.with_noise(1.0, 30.0))
    run = first_pass(problem)
    i = problem.layout["accel_cross_coupling"]
    factor = run.belief.factor.copy()
    factor[i] *= 30.0
    return problem, replace(run, belief=Belief(run.belief.mean, factor))


def test_false_information_is_the_share_of_the_noise_in_the_innovations(weak):
    """With all of the innovations' variance from the noise of the accelerometers there is one for each number."""
    problem, run = weak
    found = false_information(problem, run, further_pass)
    numbers = np.sum(~np.isnan(run.history.innovation[:, :3])) + np.sum(~np.isnan(run.history.innovation[:, 6:]))
    assert 0.2 * numbers / 3.0 < found["accel_cross_coupling"] < numbers / 3.0


def test_there_is_none_to_speak_of_with_quiet_sensors():
    problem = camera_problem()
    quiet = replace(problem, readings=problem.readings.with_noise(0.1, 0.1))
    assert false_information(quiet, first_pass(quiet), further_pass) == {}


@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_the_slope_of_a_line_with_noise_in_both_variables(weak, noise):
    """Least squares finds K x / (x + n) of a true K, with variances x and n: with n known, K again."""
    problem, run = weak
    d, n = problem.layout["accel_cross_coupling"], problem.layout.degrees
    signal, K = 400.0, run.parameters.stored("accel_cross_coupling")
    sd = np.full(n, 1e-3)
    sd[d] = (signal * (1.0 + noise)) ** -0.5
    mean = run.belief.mean.copy()
    mean[problem.layout.stored("accel_cross_coupling")] = K / (1.0 + noise)
    seen = replace(
        run,
        belief=Belief(mean, np.diag(sd)),
        parameters=replace(
            run.parameters, sensors=replace(run.parameters.sensors, K_a=K.reshape(3, 3) / (1.0 + noise))
        ),
    )
    found = without_attenuation(problem, seen, {"accel_cross_coupling": signal * noise})
    np.testing.assert_allclose(found.parameters.stored("accel_cross_coupling"), K, rtol=1e-9)
    variance = np.diag(found.belief.covariance)[d]
    np.testing.assert_allclose(variance, 1.0 / signal + noise / signal, rtol=1e-6)  # 1/I + F/I^2

"""The published method, and comparisons of recordings without a reference."""

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.errors import RecordingError
from kreisel.preparation.gravity import site_of
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.plain_method import plain_values
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.static_comparison import STATIC_ESTIMATORS, compare_static
from kreisel.validation.checks import check_streams


def test_many_attitudes_give_the_true_values():
    truth, recording = hand_turned(HandTurns("fog-mems", attitudes=40, rest=2.0), np.random.default_rng(5))
    imu = check_streams(recording).imu
    problem = RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0])
    true, found = turned(truth, upper_triangular(truth.K_a)[0], np.zeros(3)), plain_values(problem)
    np.testing.assert_allclose(found.K_omega, true.K_omega, atol=2e-3)
    np.testing.assert_allclose(found.K_a, true.K_a, atol=5e-4)
    np.testing.assert_allclose(found.k_a[0], true.k_a[0], atol=5e-3)
    np.testing.assert_allclose(found.k_w[0], -imu.rates[problem.rests.first[0] : problem.rests.last[0]].mean(axis=0))
    with pytest.raises(RecordingError, match="expected 6 or more"):
        plain_values(RestProblem(imu, problem.raw, problem.rests.part(np.arange(3)), problem.site))


def test_three_ways_side_by_side():
    _, recording = hand_turned(HandTurns("fog-mems", attitudes=24, rest=2.0), np.random.default_rng(8))
    compared = compare_static(check_streams(recording), STATIC_ESTIMATORS)
    walking, constant, published = compared.found
    assert [one.name for one in compared.found] == list(STATIC_ESTIMATORS)
    assert (walking.result, constant.result, published.result) == ("accepted", "accepted", "not judged")
    name = "gyroscope.cross_coupling[0,0]"
    assert 0.0 < abs(published.estimate[name] - walking.estimate[name]) < 5.0 * walking.standard_deviation[name]
    assert np.isfinite(published.derived["gyro_scale_error_ppm"].value).all()
    assert published.standard_deviation == {}


def test_a_recording_that_shows_nothing_is_a_failure_of_each():
    _, recording = hand_turned(HandTurns("fog-mems", attitudes=4, rest=2.0), np.random.default_rng(8))
    compared = compare_static(check_streams(recording), STATIC_ESTIMATORS)
    assert not compared.done
    assert all("expected 6 or more" in one.error for one in compared.found)

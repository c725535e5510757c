"""First values: which gyro axis belongs to which accelerometer, and that no mirror image is taken."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.errors import RecordingError
from kreisel.preparation.gravity import site_of
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.first_values import first_values
from kreisel.static.multi_position import estimate_static
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.validation.checks import check_streams


def case(seed, **how):
    truth, recording = hand_turned(HandTurns("fog-mems", **how), np.random.default_rng(seed))
    imu = check_streams(recording).imu
    problem = RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0])
    return turned(truth, upper_triangular(truth.K_a)[0], np.zeros(3)), problem


@pytest.mark.parametrize("seed", range(8))
def test_half_turns_do_not_decide_which_axis_is_which(seed):
    """Half turns from face to face, which fit four choices alike, are more than half of all."""
    truth, problem = case(seed, laid="faces", attitudes=12, rest=2.0)
    sensors = first_values(problem).sensors
    np.testing.assert_allclose(sensors.K_omega, truth.K_omega, atol=0.06)
    np.testing.assert_allclose(sensors.K_a, truth.K_a, atol=0.06)


def test_a_mirror_image_is_turned_back():
    """Forces reflected, and rates as axial vectors, explain all readings as well."""
    truth, problem = case(3, attitudes=14, rest=2.0)
    start = first_values(problem)
    S = np.diag([1.0, 1.0, -1.0])
    start.sensors.K_a[:] = S @ start.sensors.K_a
    start.sensors.K_omega[:] = np.linalg.det(S) * S @ start.sensors.K_omega
    found = estimate_static(problem, start).parameters.sensors
    np.testing.assert_allclose(found.K_omega, truth.K_omega, atol=2e-3)
    np.testing.assert_allclose(found.K_a, truth.K_a, atol=2e-3)


def test_too_few_standstills_are_said():
    _, problem = case(1, attitudes=5, rest=2.0)
    with pytest.raises(RecordingError, match="expected 6 or more"):
        first_values(problem)


def test_rates_in_another_unit_than_the_stated_are_said():
    """Taken for deg/s, and changed to rad/s once more."""
    _, problem = case(2, attitudes=12, rest=2.0)
    imu = replace(problem.imu, rates=np.pi / 180.0 * problem.imu.rates)
    wrong = RestProblem(imu, raw_of(imu), find_rests(imu), problem.site)
    with pytest.raises(RecordingError, match="57.3 times as far in the device as its rates say: are they in rad/s, "):
        first_values(wrong)

"""Effects by evidence, and faces that are less square than was thought, in recordings by hand."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.device_axes import upper_triangular
from kreisel.errors import RecordingError
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.preparation.gravity import site_of
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static import rest_chain
from kreisel.static.first_values import first_values
from kreisel.static.multi_position import estimate_static
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.slow_turn import common_turn
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams


def turned(seed=4, **how):
    truth, recording = hand_turned(HandTurns("consumer-mems", **how), np.random.default_rng(seed))
    return truth, check_streams(recording)


def problem_of(recording):
    imu = recording.imu
    return RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0])


@pytest.mark.parametrize("attitudes", [8, 24])
def test_effects_that_the_data_say_little_of_hardly_change_the_evidence(attitudes):
    """Of a device that has none: whatever the unit of an effect, it costs no more than its data are worth."""
    problem = problem_of(turned(attitudes=attitudes, rest=3.0)[1])
    found = estimate_static(problem, first_values(problem))
    gains = {one.group: one.gain for one in found.considered}
    assert {"gyro_asymmetry", "accel_asymmetry"} <= gains.keys()
    assert all(-8.0 < gain < 3.0 for gain in gains.values()), gains
    assert gains["gyro_asymmetry"] > -3.0


@pytest.mark.parametrize("seed", range(3))
def test_quadratic_accelerometers_are_found_on_faces(seed):
    """Terms of 0.3 % at g would be 20 deviations of offsets; turns of the gyros show them between faces."""
    _, recording = turned(seed, attitudes=18, laid="faces", quadratic=3e-4)
    outcome = calibrate_static(recording)
    considered = {one.group: one for one in outcome.found.considered}
    assert considered["accel_polynomial"].included
    assert considered["accel_polynomial"].gain > 10.0


@pytest.mark.parametrize("seed", range(2))
def test_accelerometers_whose_scale_differs_with_the_sign_are_not_taken_for_quadratic_ones(seed):
    """Of 0.2 % on average: square terms, which explain most of it, would be 13 deviations off."""
    _, recording = turned(seed, attitudes=30)
    force = recording.imu.accelerations
    readings = force + np.array([2e-3, -3e-3, 2e-3]) * np.abs(force)
    outcome = calibrate_static(replace(recording, imu=replace(recording.imu, accelerations=readings)))
    considered = {one.group: one for one in outcome.found.considered}
    assert considered["accel_asymmetry"].included
    assert not considered["accel_polynomial"].included
    off = outcome.found.parameters.sensors.others["accel_asymmetry"] + [2e-3, -3e-3, 2e-3]
    assert np.abs(off / considered["accel_asymmetry"].deviation).max() < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_standstills_that_all_turn_about_one_axis_are_seen_by_gravity(seed):
    """To the gyros such a turn is an offset: it was up to 58 deviations off."""
    twist = np.array([4e-4, -6e-4, 2e-4])
    truth, recording = turned(seed, attitudes=20, twist=tuple(twist))
    np.testing.assert_allclose(common_turn(find_rests(recording.imu)), twist, atol=1e-4)
    outcome = calibrate_static(recording)
    assert any("the device turns at its standstills" in warning.message for warning in outcome.warnings)
    offset = outcome.calibration.sensors.k_w[0] - truth.k_w[0]
    assert np.abs(offset).max() > 2e-4
    assert np.abs(offset / outcome.calibration.sensor_sd.k_w[0]).max() < 3.0
    assert largest(outcome, truth) < 4.0


@pytest.mark.parametrize("how", [{}, {"creep": 3e-3}, {"slip": 5e-3}, {"tremor": 2e-3}, {"attitudes": 7}])
def test_standstills_that_turn_about_any_axis_have_no_turn_in_common(how):
    for seed in range(4):
        assert not common_turn(find_rests(turned(seed, **how)[1].imu)).any()


@pytest.mark.parametrize("seed", range(3))
def test_cubic_gyros_are_found_in_many_attitudes(seed):
    """Of 1 % at 6 rad/s, which was up to six deviations of the scale factors while no term could say it."""
    truth, recording = turned(seed, attitudes=24, turn=1.2, gyro_cubic=3e-4)
    outcome = calibrate_static(recording)
    found = {one.group: one for one in outcome.found.considered}["gyro_cubic"]
    assert found.included
    assert found.gain > 5.0
    assert np.abs((found.value - truth.others["gyro_cubic"]) / found.deviation).max() < 4.0
    assert largest(outcome, truth) < 4.0


def test_effects_that_are_not_chosen_widen_what_they_would_change():
    problem = problem_of(turned(1, attitudes=12, rest=3.0, quadratic=5e-5)[1])
    found = estimate_static(problem, first_values(problem))
    place = problem.layout["accel_offset"]
    assert "accel_polynomial" not in found.problem.effects
    beyond = np.sqrt(np.sum(found.undecided[place] ** 2, axis=1))
    assert (beyond > 0.1 * found.deviation[place]).any()


@pytest.mark.parametrize(("attitudes", "separate"), [(6, False), (12, True)])
def test_each_face_once_does_not_show_square_terms_and_that_is_said(attitudes, separate):
    _, recording = turned(1, attitudes=attitudes, laid="whole turns", quadratic=3e-4)
    outcome = calibrate_static(recording)
    considered = {one.group: one for one in outcome.found.considered}
    assert considered["accel_polynomial"].included is separate
    assert any("offsets hold at one g" in one.message for one in outcome.warnings) is not separate


@pytest.mark.parametrize("stated", [0.0, 2e-3])
def test_faces_are_as_far_from_right_angles_as_the_data_show(stated):
    truth, recording = turned(2, attitudes=18, laid="faces", squareness=25e-3, laid_error=1e-3)
    outcome = calibrate_static(recording, squareness=stated)
    assert any("not at right angles" in one.message for one in outcome.warnings)
    assert largest(outcome, truth) < 4.0


def test_square_faces_are_left_alone():
    _, recording = turned(2, attitudes=18, laid="faces")
    assert not any("not at right angles" in one.message for one in calibrate_static(recording).warnings)


def largest(outcome, truth: SensorParameters) -> float:
    """Return the largest error of the accelerometers' matrix in their own frame, in deviations."""
    _, expected = upper_triangular(truth.K_a)
    sd = outcome.calibration.sensor_sd.K_a
    error = outcome.calibration.sensors.K_a - expected
    return float(np.max(np.abs(error[sd > 0.0]) / sd[sd > 0.0]))


def test_equations_that_nothing_solves_are_said_to_fit_nothing(monkeypatch):
    """Where no size of the noise gives equations that are positive definite: no number may come from them."""
    problem = problem_of(turned(attitudes=8, rest=3.0)[1])
    start = first_values(problem)

    eliminate = rest_chain.eliminate

    def unsolved(rows, weights, *rest):
        return eliminate(rows, -weights, *rest)

    monkeypatch.setattr(rest_chain, "eliminate", unsolved)
    with np.errstate(invalid="ignore"), pytest.raises(RecordingError, match="do not fit standstills and turns"):
        estimate_static(problem, start)

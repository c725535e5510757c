"""The latitude against the Earth's rotation in the readings: geometry by drawn vectors, and simulated cells."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from kreisel.calibration.latitude_check import SEEN, _compared, _isotropic, _linearised, check_latitude
from kreisel.inertial.earth import EARTH_RATE
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import usual_covariance, with_groups
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.refinement.turning_reference import with_free_earth_rate

from ...small_cell import simulate
from ...small_problem import estimate_of, small_problem, small_run

TRUE = 49.2571


def rotation(latitude, heading):
    phi = np.radians(latitude)
    return np.array([np.cos(phi) * np.cos(heading), np.cos(phi) * np.sin(heading), -np.sin(phi)])


def covariance(rng, size):
    A = size * rng.normal(size=(3, 3))
    return A @ A.T + (0.3 * size) ** 2 * np.eye(3)


@pytest.mark.parametrize("latitude", [-70.0, -12.0, 5.0, TRUE])
@pytest.mark.parametrize("heading", [0.0, 2.2, -1.0])
def test_the_latitude_found_is_the_angle_of_the_rotation_above_the_horizon(latitude, heading):
    rate = rotation(latitude, heading)
    found = _compared(rate[:2], rate[2], 1e-4 * np.eye(3), -np.sin(np.radians(30.0)))
    assert found.found_deg == pytest.approx(latitude, abs=0.006)  # a hundredth of a degree is looked at
    assert found.stated_deg == pytest.approx(30.0, abs=1e-9)


def test_the_deviation_is_that_of_latitudes_of_drawn_rotations():
    """The best latitude of a thousand draws: a deviation is good to 2.2 %."""
    rng = np.random.default_rng(0)
    rate, sd = rotation(TRUE, 0.7), np.array([0.012, 0.012, 0.004])
    drawn, P = rate + sd * rng.normal(size=(1000, 3)), np.diag(sd**2)
    latitudes = [c.found_deg for one in drawn if (c := _compared(one[:2], one[2], P, -0.5)) is not None]
    assert len(latitudes) > 990  # the size of the others is off by more than three deviations
    found = _compared(rate[:2], rate[2], np.diag(sd**2), -np.sin(np.radians(TRUE)))
    assert found.deviation_deg == pytest.approx(np.std(latitudes), rel=0.07)


def test_the_score_is_how_much_worse_the_stated_latitude_fits_than_the_best():
    """Distances to rotations of the Earth's size, in the metric of P: north may lie anywhere."""
    rng = np.random.default_rng(1)
    P, stated = covariance(rng, 0.004), TRUE
    rate = rotation(stated, 0.7) + 0.01 * rng.normal(size=3)
    inverse = np.linalg.inv(P)

    def square(x):
        off = rate - rotation(x[0], x[1])
        return off @ inverse @ off

    at_stated = minimize(lambda heading: square([stated, heading[0]]), [0.7]).fun
    anywhere = minimize(square, [stated, 0.7], method="Nelder-Mead").fun
    found = _compared(rate[:2], rate[2], P, -np.sin(np.radians(stated)))
    assert found.score == pytest.approx((at_stated - anywhere) ** 0.5, rel=0.05)
    assert found.score > 1.0


def test_a_rotation_of_another_size_is_not_the_latitude():
    """The Earth's rate is known: what is found then is something else, such as a response to acceleration."""
    P, stated = 1e-4 * np.eye(3), -np.sin(np.radians(TRUE))
    wrong = rotation(20.0, 0.7)
    assert _compared(wrong[:2], wrong[2], P, stated).score > 10.0
    larger = 1.05 * wrong
    assert _compared(larger[:2], larger[2], P, stated) is None
    assert _compared(wrong[:2], wrong[2], 0.04 * np.eye(3), stated) is None  # 11 deg are no latitude


def test_near_a_pole_the_latitude_is_as_certain_as_the_level_part():
    found = _compared(np.array([3e-5, 4e-5]), -1.0, 1e-4 * np.eye(3), -1.0)
    assert found.found_deg == pytest.approx(90.0 - np.degrees(5e-5), abs=0.006)
    assert found.deviation_deg == pytest.approx(np.degrees(0.01), rel=1e-3)
    assert found.score < 0.01


@cache
def quiet_cell(latitude=TRUE):
    """Two minutes, which show north to about a tenth of the Earth's rate; the problem for a stated latitude."""
    recording = simulate(np.random.default_rng(3), 120.0, Path("small"), imu_rate=50.0)[1]
    site = recording.settings.site.model_copy(update={"latitude_deg": latitude})
    recording = replace(recording, settings=recording.settings.model_copy(update={"site": site}))
    problem = build_problem(prepare_recording(recording, CalibrationSettings()), CalibrationSettings())
    return problem, KalmanFilter().fit(problem)


def test_the_right_latitude_is_found():
    found = check_latitude(estimate_of(*quiet_cell()))
    assert found.stated_deg == pytest.approx(TRUE)
    assert abs(found.found_deg - TRUE) < 4.0 * found.deviation_deg
    assert found.deviation_deg < 6.0
    assert found.score < 3.7  # chi-square of two degrees of freedom: one in a thousand


@pytest.mark.parametrize("wrong", [10.0, -TRUE])
def test_a_wrong_latitude_does_not_change_what_the_readings_show(wrong):
    right, found = check_latitude(estimate_of(*quiet_cell())), check_latitude(estimate_of(*quiet_cell(wrong)))
    assert found.stated_deg == pytest.approx(wrong)
    assert found.found_deg == pytest.approx(right.found_deg, abs=0.3 * right.deviation_deg)
    assert found.score > 6.0


@pytest.mark.parametrize("stated", [TRUE, 40.0, 60.0, 20.0])
def test_to_first_order_the_check_is_that_of_a_run(stated):
    problem, fit = quiet_cell(stated)
    by_run = check_latitude(estimate_of(problem, fit))
    found = replace(estimate_of(problem, fit), linear=KalmanFilter().linearise(problem, fit))
    first = _linearised(found, -np.sin(np.radians(stated)), 1.0)
    assert first.found_deg == pytest.approx(by_run.found_deg, abs=0.25 * by_run.deviation_deg)
    assert first.deviation_deg == pytest.approx(by_run.deviation_deg, rel=0.03)
    assert first.score == pytest.approx(by_run.score, abs=0.25)


def test_a_latitude_that_fits_to_first_order_needs_no_run(monkeypatch):
    problem, fit = quiet_cell()
    found = replace(estimate_of(problem, fit), linear=KalmanFilter().linearise(problem, fit))
    monkeypatch.setattr(KalmanFilter, "fit", None)
    assert check_latitude(found).score < 2.0


def test_a_wrong_latitude_is_no_response_to_acceleration_that_is_the_same_in_all_axes():
    problem, _ = quiet_cell(-TRUE)
    group = "gyro_g_sensitivity"
    larger = with_groups(problem, (group,), {group: usual_covariance(group, problem)})
    larger = replace(larger, prior=replace(larger.prior, likely=(group,)))
    fit = KalmanFilter().fit(larger)
    G = fit.parameters.sensors.effects[group].reshape(3, 3)
    assert np.trace(G) / 3.0 < -6e-6  # twice the Earth's vertical rate over gravity is 1.1e-5
    found = check_latitude(estimate_of(larger, fit))
    assert abs(found.found_deg - TRUE) < 4.0 * found.deviation_deg
    assert found.doubtful


@pytest.mark.parametrize(("off", "same"), [(0.3, True), (8.0, False)])
def test_numbers_that_differ_by_their_deviations_are_the_same_in_all_axes(off, same):
    G = 20.0 * np.eye(3) + off * np.random.default_rng(5).normal(size=(3, 3))
    layout = type("Layout", (), {"__getitem__": lambda *_: slice(0, 9), "stored": lambda *_: slice(0, 9)})()
    free = SimpleNamespace(layout=layout, prior=SimpleNamespace(covariance={"gyro_g_sensitivity": 100.0 * np.eye(9)}))
    fit = SimpleNamespace(belief=SimpleNamespace(mean=G.ravel(), covariance=np.eye(9)))
    ratio = _isotropic(free, fit)
    off_line = G - np.trace(G) / 3.0 * np.eye(3)
    assert ratio == pytest.approx(8 * np.log(10.0) - 0.5 * np.sum(off_line**2))
    assert (ratio > 5.0) == same


def test_without_a_latitude_or_without_north_there_is_nothing_to_check():
    problem, run = quiet_cell()
    assert check_latitude(estimate_of(replace(problem, site=replace(problem.site, earth_rate_n=None)), run)) is None
    kept = [part for part in problem.layout if part.name != "north"]
    assert check_latitude(estimate_of(replace(problem, layout=type(problem.layout)(kept)), run)) is None


def test_gyros_that_do_not_see_the_earth_turn_check_nothing():
    problem, run = small_problem(), small_run()
    assert run.belief.standard_deviation[problem.layout["north"]].max() > SEEN / np.cos(np.radians(TRUE))
    assert check_latitude(estimate_of(problem, run)) is None


def test_the_free_problem_begins_at_the_run_and_knows_nothing_of_the_rotation():
    problem, run = quiet_cell()
    free = with_free_earth_rate(problem, run)
    assert free.site.earth_rate_units == (EARTH_RATE, EARTH_RATE)
    assert free.groups == tuple(
        g for known in problem.groups for g in ((known, "earth_down") if known == "north" else (known,))
    )
    phi = np.radians(TRUE)
    start = free.prior.start
    rate = np.array([*start.north, start.earth_down])  # in units of the Earth's rate now
    np.testing.assert_allclose(rate, [*(np.cos(phi) * run.parameters.north), -np.sin(phi)], rtol=1e-12)
    np.testing.assert_array_equal([*free.prior.value.north, free.prior.value.earth_down], 0.0)
    for covariance_of in (free.prior.covariance, free.prior.start_covariance):
        np.testing.assert_allclose(covariance_of["north"], np.eye(2) / 3.0)  # an isotropic vector of unit length
        np.testing.assert_allclose(covariance_of["earth_down"], np.eye(1) / 3.0)


def test_the_deviation_counts_correlation_of_level_and_vertical_part():
    """Against the best latitudes of drawn rotations."""
    rng = np.random.default_rng(5)
    true, stated = np.radians(50.0), -np.sin(np.radians(50.0))
    north, vertical = np.array([np.cos(true), 0.0]), -np.sin(true)
    A = 0.01 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]])
    check = _compared(north, vertical, A @ A.T, stated)
    drawn = np.array([*north, vertical]) + rng.normal(size=(1000, 3)) @ A.T
    latitudes = [c.found_deg for one in drawn if (c := _compared(one[:2], one[2], A @ A.T, stated)) is not None]
    assert len(latitudes) > 990
    assert check.deviation_deg == pytest.approx(np.std(latitudes), rel=0.07)


def test_a_pole_has_a_latitude():
    check = _compared(np.zeros(2), -1.0, 1e-4 * np.eye(3), -1.0)
    assert check.found_deg == pytest.approx(90.0)
    assert np.isfinite(check.deviation_deg)

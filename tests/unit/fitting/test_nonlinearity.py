"""How far the model is linear: closed forms of the curvature, and conditional normal distributions."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.estimation.belief import Belief
from kreisel.fitting.fit import Fit
from kreisel.fitting.nonlinearity import (
    CURVED,
    LINEAR,
    MAX_INFLATION,
    MIN_INFLATION,
    curved,
    deviation_alone,
    linear_inflation,
)
from kreisel.fitting.stored_state import stored_state
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import with_readings, without_groups
from kreisel.preparation.build_problem import build_problem

from ...small_problem import moved_by, prepared, small_problem

ANGLES = ("gyro_cross_coupling", "accel_cross_coupling", "alignment")
N = len(small_problem().parameter_names)


def deviations(**of):
    """Deviations of all parameters, 1e-9 but for some groups: so small that they bend nothing."""
    sd = np.full(N, 1e-9)
    for group, value in of.items():
        sd[small_problem().layout[group]] = value
    return sd


def test_a_deviation_with_all_else_known_is_that_of_the_conditional_distribution():
    """By the Schur complement, parameter by parameter."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    P = A @ A.T + 0.1 * np.eye(6)
    want = []
    for i in range(6):
        others = np.delete(np.arange(6), i)
        want.append(P[i, i] - P[i, others] @ np.linalg.solve(P[np.ix_(others, others)], P[others, i]))
    np.testing.assert_allclose(deviation_alone(P), np.sqrt(want), rtol=1e-9)


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("sd", [1e-3, 5e-3])
def test_a_matrix_is_widened_until_the_square_of_its_angles_is_a_share_of_its_deviation(sensor, sd):
    """Offsets are held: with them their product would bend the model as much."""
    problem = without_groups(small_problem(), ("gyro_offset", "accel_offset"))
    deviation = np.full(len(problem.parameter_names), 1e-9)
    deviation[problem.layout[f"{sensor}_cross_coupling"]] = sd
    found = linear_inflation(problem, np.diag(deviation**2))
    assert (found * sd) ** 2 == pytest.approx(LINEAR * sd, rel=1e-9)


def test_matrix_and_offset_are_widened_until_their_product_is_a_share_of_the_offset_alone():
    """The offset is correlated with the matrix: alone it is known better by the root of one less its square."""
    layout, sd_matrix, sd_offset, rho = small_problem().layout, 1e-3, 0.1, 0.9
    P = np.diag(deviations(accel_cross_coupling=sd_matrix, accel_offset=sd_offset) ** 2)
    K, o = layout["accel_cross_coupling"].start, layout["accel_offset"].start
    for k in range(3):
        P[K + k, o + k] = P[o + k, K + k] = rho * sd_matrix * sd_offset
    found = linear_inflation(small_problem(), P)
    alone = sd_offset * (1.0 - rho**2) ** 0.5
    assert found * sd_matrix * found * sd_offset == pytest.approx(LINEAR * alone, rel=1e-6)


def test_widening_stays_between_its_bounds():
    small = np.diag(deviations() ** 2)
    assert linear_inflation(small_problem(), small) == MAX_INFLATION
    assert linear_inflation(small_problem(), 1e18 * small) == MIN_INFLATION
    held = without_groups(small_problem(), ("gyro_cross_coupling", "accel_cross_coupling", "time_offset", "time_skew"))
    n = len(held.parameter_names)
    assert linear_inflation(held, np.eye(n)) == MAX_INFLATION  # without matrices and clocks nothing bends


@pytest.mark.parametrize(("offset", "skew"), [(0.01, 1e-9), (1e-9, 1e-3), (0.02, 1e-3)])
def test_time_is_widened_until_the_square_of_its_error_turns_by_a_share_of_what_it_turns_by_itself(offset, skew):
    """A turn sin(w t) by an error of time d is cos(w t) d - (w / 2) sin(w t) d^2, of the same mean squares."""
    problem = build_problem(prepared(), CalibrationSettings(skew=True))
    readings, w = problem.sensor.readings, 2.0
    wave = np.outer(np.cos(w * readings.stamps), [0.3, -0.2, 0.1]) - problem.prior.start.sensors.k_w[0]
    problem = with_readings(problem, readings.with_values(rates=wave))
    P = 1e-18 * np.eye(len(problem.parameter_names))
    i, j = problem.layout["time_offset"].start, problem.layout["time_skew"].start
    P[[i, j], [i, j]], P[[i, j], [j, i]] = (offset**2, skew**2), -0.5 * offset * skew
    tau = np.array([update.tau for update in problem.schedule.updates])
    sd = np.mean(offset**2 - offset * skew * tau + skew**2 * tau**2) ** 0.5
    assert linear_inflation(problem, P) ** 2 * sd * w / 2.0 == pytest.approx(LINEAR, rel=0.06)  # means between updates


def run_from(change, sd):
    """A run whose result lies a change away from its start."""
    problem = small_problem()
    start = problem.prior.start
    end = stored_state(problem, moved_by(problem, start, change))
    factor = np.diag(np.concatenate([sd, np.ones(problem.layout.degrees - N)]))
    return Fit(start, Belief(end, factor), start, None)


@pytest.mark.parametrize("group", ANGLES)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_way_of_angles_is_curved_once_its_square_exceeds_a_share_of_the_least_deviation(group, sign):
    """Offsets move by nothing, so that only the square counts."""
    sd = deviations(gyro_cross_coupling=4e-4, accel_cross_coupling=9e-4, alignment=1e-4)
    far = (CURVED * 1e-4) ** 0.5
    for share, bent in ((0.99, False), (1.01, True)):
        change = np.zeros(N)
        change[small_problem().layout[group].stop - 1] = sign * share * far
        assert curved(small_problem(), run_from(change, sd)) is bent


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_offset_and_matrix_are_curved_once_the_product_of_their_ways_exceeds_a_share_of_the_deviation(sensor):
    layout = small_problem().layout
    sd = np.full(N, 1.0)  # the squares of angles do not count
    sd[layout[f"{sensor}_offset"]] = 1e-3
    for share, bent in ((0.99, False), (1.01, True)):
        change = np.zeros(N)
        change[layout[f"{sensor}_cross_coupling"].start + 4] = -0.01
        change[layout[f"{sensor}_offset"].start + 2] = share * CURVED * 1e-3 / 0.01
        assert curved(small_problem(), run_from(change, sd)) is bent


def test_of_an_offset_the_deviation_alone_counts():
    """An offset that is correlated with its matrix is known better than its deviation says."""
    layout = small_problem().layout
    matrix, offset = layout["gyro_cross_coupling"].start, layout["gyro_offset"].start
    change = np.zeros(N)
    change[matrix], change[offset] = 0.01, 0.5 * CURVED * 1e-3 / 0.01
    run = run_from(change, deviations(gyro_offset=1e-3) + 1.0 * (deviations(gyro_offset=1e-3) < 1e-8))
    assert not curved(small_problem(), run)
    factor = run.belief.factor.copy()
    for k in range(3):  # correlation 0.995 with an entry of the matrix: alone it is known ten times better
        factor[offset + k, matrix + k], factor[offset + k, offset + k] = 0.995e-3, 1e-4
    assert curved(small_problem(), replace(run, belief=replace(run.belief, factor=factor)))


def test_where_nothing_moves_nothing_is_curved():
    assert not curved(small_problem(), run_from(np.zeros(N), deviations()))

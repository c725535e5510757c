"""The truth of a cell in the terms of a problem: checked by what its sensors and clocks must show."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import correct_angular_rate, correct_specific_force
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import without_groups
from kreisel.simulation.cell import Truth
from kreisel.simulation.cell_settings import Imu
from kreisel.simulation.device_errors import draw_effects
from kreisel.simulation.imu import ideal_readings
from kreisel.study.truth import judged, true_parameters

from ...navigation import corrected
from ...oracle import quaternions as quat
from ...small_problem import moved_by, recorded, small_problem, small_run

SKEW = 3e-5


@pytest.fixture(scope="module")
def truth():
    small, recording = recorded()
    del recording
    return Truth(small.sensors, small.time_offset, SKEW, small.gravity_r, np.zeros(3), None, None)


def of(truth, problem=None, found=None):
    return true_parameters(truth, recorded()[1], problem or small_problem(), found or small_run().parameters)


def test_sensors_that_are_seen_in_full_are_those_of_the_cell(truth):
    p = of(truth)
    for name in ("K_omega", "k_w", "K_a", "k_a", "lever_arms"):
        np.testing.assert_array_equal(getattr(p.sensors, name), getattr(truth.sensors, name))


@pytest.mark.parametrize("order", [1, 3])
def test_polynomials_are_as_long_as_the_problems_and_correct_alike(truth, order):
    problem = replace(small_problem(), settings=CalibrationSettings(polynomial_order=order))
    p = of(truth, problem)
    assert p.sensors.k_w.shape == p.sensors.k_a.shape == (order, 3)
    raw = np.random.default_rng(0).normal(size=(10, 3))
    np.testing.assert_allclose(
        correct_angular_rate(raw, p.sensors), correct_angular_rate(raw, truth.sensors), rtol=1e-14
    )


def test_effects_of_the_device_are_part_of_its_truth(truth):
    """The solver of the virtual cell and the corrections of the model are inverse to each other with them."""
    imu = Imu(gyro_g_sensitivity_sd=1e-4, gyro_asymmetry_sd=1e-3, accel_asymmetry_sd=1e-3, gyro_temperature_sd=1e-3,
              accel_scale_temperature_sd=1e-3, gyro_g_squared_sd=1e-6)  # fmt: skip
    effects = draw_effects(np.random.default_rng(1), imu, GRADES["fog"])
    t = np.arange(20.0)
    omega, force = np.random.default_rng(2).normal(size=(2, 20, 3))
    p = of(replace(truth, effects=effects)).sensors
    w, a = ideal_readings(omega, np.zeros((20, 3)), force, replace(p, lever_arms=np.zeros((3, 3))), effects, t)
    found, _ = corrected(t, w, a, p, np.zeros((20, 3)))
    np.testing.assert_allclose(found, omega, rtol=0, atol=1e-10)
    assert set(p.others) >= {"gyro_g_sensitivity", "accel_delay", "accel_scale_temperature"}


def test_polynomials_longer_than_the_problems_are_cut(truth):
    sensors = replace(truth.sensors, k_w=np.arange(9.0).reshape(3, 3), k_a=-np.arange(9.0).reshape(3, 3))
    p = of(replace(truth, sensors=sensors), replace(small_problem(), settings=CalibrationSettings(polynomial_order=2)))
    np.testing.assert_array_equal(p.sensors.k_w, np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(p.sensors.k_a, -np.arange(6.0).reshape(2, 3))


def test_from_positions_alone_the_body_is_turned_so_that_the_gyros_are_as_square_as_can_be(truth):
    """Corrected rates and forces are those of the cell, turned alike; K_omega is then symmetric (polar factor)."""
    turned = quat.matrix(quat.exp(np.array([0.3, -0.5, 0.2])))
    sensors = replace(truth.sensors, K_omega=turned @ truth.sensors.K_omega, K_a=turned @ truth.sensors.K_a,
                      lever_arms=truth.sensors.lever_arms @ turned.T)  # fmt: skip
    problem = replace(small_problem(), reference=replace(small_problem().reference, quaternions=None))
    p = of(replace(truth, sensors=sensors), problem).sensors
    np.testing.assert_allclose(p.K_omega, p.K_omega.T, atol=1e-14)
    rng = np.random.default_rng(1)
    w, a, alpha = (rng.normal(size=(20, 3)) for _ in range(3))
    omega, found = correct_angular_rate(w, sensors), correct_angular_rate(w, p)
    C = np.linalg.lstsq(omega, found, rcond=None)[0].T
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(C) == pytest.approx(1.0)
    force = correct_specific_force(a, omega, alpha, sensors)
    np.testing.assert_allclose(correct_specific_force(a, found, alpha @ C.T, p), force @ C.T, atol=1e-12)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.02, -0.03, 0.0), (0.4, 0.5, 1.2)])
def test_gravity_is_the_true_one_and_its_frame_turned_about_no_vertical(truth, turn):
    """From what was found, by the shortest way: a turn about axes across down."""
    found = replace(small_run().parameters, q_rn=quat.multiply(small_run().parameters.q_rn, quat.exp(np.array(turn))))
    p = of(truth, found=found)
    down = quat.rotate(p.q_rn, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(p.gravity * down, truth.gravity_r, rtol=1e-12, atol=1e-12)
    step = quat.log(quat.multiply(quat.conjugate(found.q_rn), p.q_rn))
    assert step[2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_array_equal(p.north, found.north)


@pytest.mark.parametrize("apart", [0, 7_000_000_000])
def test_the_clock_takes_poses_to_the_imus_seconds(truth, apart):
    """One instant by both clocks, from the stamps themselves."""
    recording, problem = recorded()[1], small_problem()
    reference = replace(problem.reference, stamps_ns=problem.reference.stamps_ns + apart)
    p = of(truth, replace(problem, reference=reference))
    for pose in (0, 1500):
        since_first = (reference.stamps_ns[pose] - reference.stamps_ns[0]) * 1e-9
        t_imu = (reference.stamps_ns[pose] - recording.imu.stamps_ns[0]) * 1e-9 + truth.time_offset + SKEW * since_first
        assert p.clock.imu_time(reference.seconds[pose]) == pytest.approx(t_imu, abs=1e-9)


def test_estimates_of_a_simulated_cell_lie_within_their_deviations_of_it(truth):
    """Five deviations, 33 sensor parameters and the clock: one recording in 50000 would fail."""
    problem, run = small_problem(), small_run()
    p = replace(of(replace(truth, time_skew=0.0)))
    which, names = judged(problem)
    change = np.zeros(len(problem.parameter_names))
    same = moved_by(problem, p, change)
    error = np.array([np.inf] * which.size)
    for k, (i, name) in enumerate(zip(which, names, strict=True)):
        group = next(g for g in problem.groups if problem.layout[g].start <= i < problem.layout[g].stop)
        if name.startswith("alignment.tilt"):
            step = quat.log(quat.multiply(quat.conjugate(same.q_rn), run.parameters.q_rn))
            error[k] = step[i - problem.layout[group].start]
        else:
            at = i - problem.layout[group].start
            error[k] = run.parameters.stored(group)[at] - same.stored(group)[at]
    assert np.abs(error / run.belief.standard_deviation[which]).max() < 5.0


def test_sensors_clocks_and_tilt_are_judged_and_what_hangs_on_priors_is_not():
    problem = small_problem()
    which, names = judged(problem)
    assert names == tuple(problem.parameter_names[i] for i in which)
    left = set(problem.parameter_names) - set(names)
    assert left == {"alignment.north[0]", "alignment.north[1]", "alignment.gravity_magnitude"}
    assert "timing.offset" in names
    assert "alignment.tilt[1]" in names


def test_where_nothing_is_estimated_nothing_is_judged():
    problem = small_problem()
    which, names = judged(without_groups(problem, tuple(g for g in problem.groups if g != "north")))
    assert which.shape == (0,)
    assert which.dtype == np.int64
    assert names == ()

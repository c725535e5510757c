"""Equations of standstills and turns: their derivatives against differences, and that the truth solves them."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.geometry.rotation import exp, matrix
from kreisel.inertial.noise_figures import GRADES
from kreisel.preparation.gravity import site_of
from kreisel.simulation import standstills
from kreisel.static.first_values import first_values
from kreisel.static.multi_position import fitted
from kreisel.static.rest_chain import ATTITUDE
from kreisel.static.rest_equations import attitudes_by, linearised
from kreisel.static.rest_noise import NO_NOISE
from kreisel.static.rest_problem import RestProblem, begun, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.turns import turns_between
from kreisel.validation.checks import check_streams

EFFECTS = ("gyro_g_sensitivity", "gyro_asymmetry", "accel_asymmetry")


@pytest.fixture(scope="module")
def quiet():
    """A device without noise; its parameters in b, and the problem."""
    silent = replace(
        GRADES["consumer-mems"], gyro_noise_density=0.0, accel_noise_density=0.0, gyro_bias_instability=0.0,
        accel_bias_instability=0.0, gyro_step=0.0, accel_step=0.0,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(standstills, "GRADES", {**GRADES, "consumer-mems": silent})
        patched.setattr(standstills, "GRAVITY_SD", 1e-7)
        truth, recording = standstills.hand_turned(standstills.HandTurns(attitudes=14), np.random.default_rng(4))
    recording = check_streams(recording)
    imu = recording.imu
    problem = RestProblem(imu, raw_of(imu), find_rests(imu), site_of(recording.settings.site)[0])
    return truth, problem.with_effects(EFFECTS)


def parameters(truth, problem):
    own = turned(truth, upper_triangular(truth.K_a)[0], np.zeros(3))
    p = begun(replace(own, others={**truth.others, "gyro_asymmetry": np.zeros(3), "accel_asymmetry": np.zeros(3)}),
              problem.site)  # fmt: skip
    return replace(p, north=np.array([1.0, 0.0]))


def test_without_noise_the_truth_is_found(quiet):
    """From no knowledge of the device: what is left is of integrating at 200 Hz."""
    truth, problem = quiet
    problem = problem.with_effects(("gyro_g_sensitivity",))
    p = parameters(truth, problem).sensors
    found = fitted(problem, first_values(problem), NO_NOISE, {})
    own = found.parameters.sensors
    np.testing.assert_allclose(own.K_a, p.K_a, atol=1e-6)
    np.testing.assert_allclose(own.k_a, p.k_a, atol=1e-5)
    np.testing.assert_allclose(own.K_omega, p.K_omega, atol=2e-5)
    np.testing.assert_allclose(own.k_w, p.k_w, atol=2e-6)
    np.testing.assert_allclose(own.others["gyro_g_sensitivity"], p.others["gyro_g_sensitivity"], atol=2e-7)
    assert np.linalg.norm(found.parameters.north) == pytest.approx(1.0, abs=0.05)


def test_derivatives_are_those_of_differences(quiet):
    truth, problem = quiet
    p = parameters(truth, problem)
    C = attitudes_by(problem, p, turns_between(problem.imu, problem.raw, problem.rests, p.sensors))
    linear = linearised(problem, p, C)
    layout = problem.layout
    for part in layout:
        for i in range(part.degrees):
            step = 1e-5 if part.name != "gyro_g_sensitivity" else 1e-6
            change = np.zeros(layout.degrees)
            change[layout[part.name].start + i] = step
            after, before = (linearised(problem, problem.changed(p, sign * change), C) for sign in (1.0, -1.0))
            for one, a, b in zip(linear.all[:3], after.all[:3], before.all[:3], strict=True):
                column = one.of_parameters[:, :, layout[part.name].start + i]
                found = (a.residual - b.residual) / (2.0 * step)
                np.testing.assert_allclose(column, found, rtol=3e-3, atol=2e-3 * max(np.abs(found).max(), 1e-3))
    for k in range(3):
        moved = C.copy()
        moved[2] = C[2] @ matrix(exp(1e-6 * np.eye(3)[k]))
        after = linearised(problem, p, moved)
        for one, a in zip(linear.all[:3], after.all[:3], strict=True):
            expected = np.zeros_like(one.residual)
            expected[one.node == 2] += one.of_node[one.node == 2][:, :, ATTITUDE][:, :, k]
            if one.of_next is not None:
                expected[one.node + 1 == 2] += one.of_next[one.node + 1 == 2][:, :, ATTITUDE][:, :, k]
            np.testing.assert_allclose((a.residual - one.residual) / 1e-6, expected, atol=2e-3)


def test_only_what_is_estimated_is_in_the_layout(quiet):
    _, problem = quiet
    assert len(problem.names) == problem.layout.degrees == problem.width.size
    assert "accelerometer.cross_coupling[1,0]" not in problem.names
    assert "alignment.earth_down" not in problem.names  # the latitude is stated

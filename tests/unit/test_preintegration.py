"""The fast form of the strapdown computation against the plain one, and its noise against sampling."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.inertial.sensor_model import SensorParameters, SizeEffect, correct_angular_rate, correct_specific_force
from kreisel.inertial.strapdown import SensorColumns, noise_covariance, preintegrate, prepare

T = np.arange(400) / 200.0
RNG = np.random.default_rng(5)


def readings():
    phase, size = RNG.uniform(0, 6, (2, 3)), RNG.uniform(0.5, 2, (2, 3))
    w = size[0] * np.sin(3.0 * T[:, None] + phase[0])
    a = 5.0 * size[1] * np.cos(4.0 * T[:, None] + phase[1]) + [0.0, 0.0, 9.8]
    return w, a


def parameters(order):
    def near(value, spread):
        return value + RNG.normal(0, spread, np.shape(value))

    return SensorParameters(
        near(np.eye(3), 0.05), near(np.zeros((order, 3)), 0.01),
        near(np.eye(3), 0.05), near(np.zeros((order, 3)), 0.01),
        near(np.zeros((3, 3)), 0.1),
    )  # fmt: skip


@pytest.mark.parametrize("form", list(SizeEffect))
@pytest.mark.parametrize("order", [1, 3])
def test_columns_that_share_a_path_agree_with_those_that_do_not(order, form):
    w, a = readings()
    signal = prepare(T, w, a, order=order)
    sets = [parameters(order) for _ in range(5)]
    gyro = [sets[0], sets[1], sets[0], sets[0], sets[0]]
    every = [np.stack([getattr(p, name) for p in sets], axis=-1) for name in ("K_a", "k_a", "lever_arms")]
    own = [np.stack([getattr(p, name) for p in gyro], axis=-1) for name in ("K_omega", "k_w")]
    plain = preintegrate(signal, 60, 156, SensorColumns.stack(form, *own, *every))
    some = [np.ascontiguousarray(part[..., :2]) for part in own]
    shared = preintegrate(signal, 60, 156, SensorColumns.stack(form, *some, *every))
    for name in ("dq", "dv", "dp", "omega_end", "alpha_end", "u_end"):
        x, y = getattr(plain, name), getattr(shared, name)
        np.testing.assert_allclose(y, x, rtol=0, atol=1e-13 * np.abs(x).max(), err_msg=name)


@pytest.mark.parametrize("form", list(SizeEffect))
def test_coefficients_are_the_sensor_model(form):
    """The kernels' linear form against equations (1) and (2) as `sensor_model` states them."""
    w, a = readings()
    signal, p = prepare(T, w, a, order=2), parameters(2)
    step = preintegrate(signal, 100, 101, SensorColumns.single(p, form))
    omega = correct_angular_rate(w, p)
    slope = signal.rate_slopes[:, 1] + p.k_w[1] * signal.rate_slopes[:, 2]
    force = correct_specific_force(a, omega, slope @ p.K_omega.T, p, form)
    np.testing.assert_allclose(step.omega_end[:, 0], omega[101], rtol=1e-13)
    np.testing.assert_allclose(step.u_path[100 - step.low], force[100], rtol=1e-13)


def test_noise_covariance_is_that_of_disturbed_readings():
    """Spread over 4000 draws of white noise; the standard error of a variance is then 2.2 per cent."""
    w, a = readings()
    dt, first, last, draws = 1.0 / 200.0, 60, 156, 4000
    sigma = (1e-3, 1e-2)
    p = replace(parameters(1), lever_arms=np.zeros((3, 3)))
    clean = prepare(T, w, a, rate_variance=np.full((399, 3), sigma[0] ** 2 * dt**2),
                    force_variance=np.full((399, 3), sigma[1] ** 2 * dt**2))  # fmt: skip
    errors = np.empty((draws, 9))
    rng = np.random.default_rng(0)
    columns = SensorColumns.single(p, SizeEffect.COMPLETED)
    centre = preintegrate(clean, first, last, columns)
    for i in range(draws):
        noisy = prepare(T, w + rng.normal(0, sigma[0], w.shape), a + rng.normal(0, sigma[1], a.shape))
        other = preintegrate(noisy, first, last, columns)
        q, q0 = other.dq[:, 0], centre.dq[:, 0]
        # left perturbation: 2 vec(q q0^-1)
        turned = 2.0 * (-q[0] * q0[1:] + q0[0] * q[1:] - np.cross(q[1:], q0[1:]))
        errors[i] = [*turned, *(other.dv - centre.dv)[:, 0], *(other.dp - centre.dp)[:, 0]]
    Q = noise_covariance(clean, first, last, centre, columns)
    shown = errors.T @ errors / draws
    scale = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(shown / np.outer(scale, scale), Q / np.outer(scale, scale), atol=0.08)

"""The fast form of the strapdown computation against the plain one, and its noise against sampling."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.inertial.sensor_model import SensorParameters, SizeEffect, correct_angular_rate, correct_specific_force
from kreisel.inertial.strapdown import prepare

from ...navigation import SensorColumns, noise_covariance, preintegrate

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

    by_power = np.logspace(-2, -1 - order, order)[:, None]
    return SensorParameters(
        near(np.eye(3), 0.05), near(np.zeros((order, 3)), by_power),
        near(np.eye(3), 0.05), near(np.zeros((order, 3)), by_power),
        near(np.zeros((3, 3)), 0.1),
    )  # fmt: skip


def columns_of(sets, turning, form):
    """Return columns of parameter sets, of which the first `turning` have gyro parameters of their own."""
    parts = [np.stack([getattr(p, name) for p in sets], axis=-1) for name in ("K_a", "k_a", "lever_arms")]
    gyro = [np.stack([getattr(p, name) for p in sets[:turning]], axis=-1) for name in ("K_omega", "k_w")]
    return SensorColumns.stack(form, *gyro, *parts)


@pytest.mark.parametrize("form", list(SizeEffect))
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("spread", [1e-6, 1e-4, 2e-3])
@pytest.mark.parametrize("uneven", [False, True])
def test_sets_beside_the_centre_agree_with_each_alone(order, form, spread, uneven):
    """Sets carried along by small turns in blocks against the plain form, every sample of every set.

    A set turns against the centre by at most 1e-4 rad in a block, by half of it from the block's middle. That times
    itself, and times what the set's force differs by, is neglected.
    """
    w, a = readings()
    t = T + (RNG.uniform(-5e-5, 5e-5, T.size) if uneven else 0.0)
    signal = prepare(t, w, a, order=order)
    centre = parameters(order)

    def near(p, size):
        moved = parameters(order)
        names = ("K_omega", "k_w", "K_a", "k_a", "lever_arms")
        return SensorParameters(*(getattr(p, n) + 20.0 * size * (getattr(moved, n) - getattr(p, n)) for n in names))

    def with_gyros_of(p, other):
        return replace(p, K_omega=other.K_omega, k_w=other.k_w)

    neglected = 0.5e-4 * (1e-4 + 20.0 * spread)
    sets = [centre, *(near(centre, spread) for _ in range(3))]
    sets += [with_gyros_of(near(centre, 0.1), centre) for _ in range(3)]
    together = preintegrate(signal, 60, 156, columns_of(sets, 4, form))
    for i, p in enumerate(sets):
        alone = preintegrate(signal, 60, 156, SensorColumns.single(p, form))
        for name in ("dq", "dv", "dp", "omega_end", "alpha_end", "u_end"):
            x, y = getattr(alone.motion, name)[..., 0], getattr(together.motion, name)[..., i]
            np.testing.assert_allclose(y, x, rtol=0, atol=neglected * np.abs(x).max(), err_msg=f"{name} of set {i}")


@pytest.mark.parametrize("form", list(SizeEffect))
def test_coefficients_are_the_sensor_model(form):
    """The kernels' linear form against equations (1) and (2) as `sensor_model` states them."""
    w, a = readings()
    signal, p = prepare(T, w, a, order=2), parameters(2)
    step = preintegrate(signal, 100, 101, SensorColumns.single(p, form))
    omega = correct_angular_rate(w, p)
    slope = signal.slopes + p.k_w[1] * 2.0 * w * signal.slopes
    force = correct_specific_force(a, omega, slope @ p.K_omega.T, p, form)
    np.testing.assert_allclose(step.motion.omega_end[:, 0], omega[101], rtol=1e-13)
    np.testing.assert_allclose(step.motion.u_path[100 - step.low, :3], force[100], rtol=1e-13)


def test_noise_covariance_is_that_of_disturbed_readings():
    """Spread over 4000 draws of white noise; the standard error of a variance is then 2.2 per cent."""
    w, a = readings()
    dt, first, last, draws = 1.0 / 200.0, 60, 156, 4000
    sigma = (1e-3, 1e-2)
    p = replace(parameters(1), lever_arms=np.zeros((3, 3)))
    density = np.array([sigma[0] ** 2 * dt, sigma[1] ** 2 * dt, 0.0, 0.0])
    clean = prepare(T, w, a, noise=np.repeat(density[:, None], 3, axis=1))
    errors = np.empty((draws, 9))
    rng = np.random.default_rng(0)
    columns = SensorColumns.single(p, SizeEffect.COMPLETED)
    begun = preintegrate(clean, first, last, columns)
    centre = begun.motion
    for i in range(draws):
        noisy = prepare(T, w + rng.normal(0, sigma[0], w.shape), a + rng.normal(0, sigma[1], a.shape))
        other = preintegrate(noisy, first, last, columns).motion
        q, q0 = other.dq[:, 0], centre.dq[:, 0]
        # left perturbation: 2 vec(q q0^-1)
        turned = 2.0 * (-q[0] * q0[1:] + q0[0] * q[1:] - np.cross(q[1:], q0[1:]))
        errors[i] = [*turned, *(other.dv - centre.dv)[:, 0], *(other.dp - centre.dp)[:, 0]]
    Q = noise_covariance(clean, begun, columns)
    shown = errors.T @ errors / draws
    scale = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(shown / np.outer(scale, scale), Q / np.outer(scale, scale), atol=0.08)

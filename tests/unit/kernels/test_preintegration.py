"""The fast form of the strapdown computation against the plain one, and its noise against sampling."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import prepare

from ...navigation import SensorColumns, corrected, noise_covariance, preintegrate

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


EFFECT_SIZES = {
    "gyro_polynomial": 3, "gyro_g_sensitivity": 9, "gyro_asymmetry": 3, "accel_polynomial": 3, "accel_asymmetry": 3,
    "accel_delay": 1, "accel_smoothing": 1, "gyro_axis_delay": 3, "gyro_axis_smoothing": 3,
}  # fmt: skip


def with_effects(p):
    """Return parameters with values of all effects, of a thousandth in their units; a smoothing of 1 ms^2."""
    others = {g: RNG.normal(0.0, 1e-6 if g.endswith("smoothing") else 1e-3, n) for g, n in EFFECT_SIZES.items()}
    powers = {g: others.pop(g)[None] for g in ("gyro_polynomial", "accel_polynomial")}
    k_w, k_a = np.vstack([p.k_w[:1], powers["gyro_polynomial"]]), np.vstack([p.k_a[:1], powers["accel_polynomial"]])
    return replace(p, k_w=k_w, k_a=k_a, others=others)


@pytest.mark.parametrize("form", list(SizeEffect))
@pytest.mark.parametrize("effects", [False, True])
@pytest.mark.parametrize("spread", [1e-6, 1e-4, 2e-3])
@pytest.mark.parametrize("uneven", [False, True])
def test_sets_beside_the_centre_agree_with_each_alone(effects, form, spread, uneven):
    """Sets carried along by small turns in blocks against the plain form, every sample of every set.

    A set turns against the centre by at most 1e-4 rad in a block, by half of it from the block's middle. That times
    itself, and times what the set's force differs by, is neglected. Effects are a part of each set beside the centre,
    and of the readings where a set stands alone; without lever arms, whose products leave out what effects change.
    """
    w, a = readings()
    t = T + (RNG.uniform(-5e-5, 5e-5, T.size) if uneven else 0.0)

    def sampled():
        p = parameters(1)
        return replace(with_effects(p), lever_arms=np.zeros((3, 3))) if effects else p

    centre = sampled()

    def near(p, size):
        moved = sampled()
        names = ("K_omega", "k_w", "K_a", "k_a", "lever_arms")
        fields = {n: getattr(p, n) + 20.0 * size * (getattr(moved, n) - getattr(p, n)) for n in names}
        return SensorParameters(**fields, others={g: v + 20.0 * size * moved.others[g] for g, v in p.others.items()})

    def with_gyros_of(p, other):
        of_gyros = {g: v for g, v in other.others.items() if g.startswith("gyro")}
        return replace(p, K_omega=other.K_omega, k_w=other.k_w, others={**p.others, **of_gyros})

    neglected = 0.5e-4 * (1e-4 + 20.0 * spread)
    sets = [centre, *(near(centre, spread) for _ in range(3))]
    sets += [with_gyros_of(near(centre, 0.1 if not effects else 0.01), centre) for _ in range(3)]
    sizes = EFFECT_SIZES if effects else {}
    signal = prepare(t, w, a, estimated=sizes, applied=centre.effects)
    together = preintegrate(signal, 60, 156, SensorColumns.stack(form, sets, 4, centre.effects))
    for i, p in enumerate(sets):
        alone = preintegrate(prepare(t, w, a, applied=p.effects), 60, 156, SensorColumns.single(p, form))
        for name in ("dq", "dv", "dp", "omega_end", "alpha_end", "u_end"):
            if effects and name == "alpha_end":
                continue  # features have no slopes: the angular acceleration leaves out what effects change
            x, y = getattr(alone.motion, name)[..., 0], getattr(together.motion, name)[..., i]
            np.testing.assert_allclose(y, x, rtol=0, atol=neglected * np.abs(x).max(), err_msg=f"{name} of set {i}")


@pytest.mark.parametrize("form", list(SizeEffect))
def test_coefficients_are_the_sensor_model(form):
    """The kernels' linear form against equations (1) and (2) as `sensor_model` states them."""
    w, a = readings()
    p = with_effects(parameters(1))
    signal = prepare(T, w, a, applied=p.effects)
    step = preintegrate(signal, 100, 101, SensorColumns.single(p, form))
    omega, force = corrected(T, w, a, p, signal.slopes @ p.K_omega.T, form)
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

"""What vibration between samples does to mean rate and force: against motion whose mean is known."""

import numpy as np
import pytest

from kreisel.geometry.rotation import log
from kreisel.inertial.strapdown import integrate_attitude, linear_rate, prepare
from kreisel.inertial.vibration import missed_by_sampling, most_missed

INTERVAL, N = 0.01, 40_000
PHASES, SIZES = np.array([0.0, 1.2, 2.5]), np.array([1.0, 0.8, 0.5])


def cone(share, amplitude=0.3, noise=0.0):
    """Rotation vectors, rates and forces of a body that returns to where it was: its mean rate is zero."""
    w = 2.0 * np.pi * share / INTERVAL
    t = INTERVAL * np.arange(N)[:, None]
    turned = amplitude / w * SIZES * np.cos(w * t + PHASES)
    speed = -amplitude * SIZES * np.sin(w * t + PHASES)
    rng = np.random.default_rng(1)
    force = np.cos(w * t + np.array([0.0, 2.0, 1.0])) + noise * rng.normal(size=(N, 3))
    return turned, speed - 0.5 * np.cross(turned, speed) + noise * rng.normal(size=(N, 3)), force


@pytest.mark.parametrize("share", [0.2, 0.3, 0.45])
def test_a_cone_in_few_samples_turns_by_what_is_missed(share):
    _, rates, forces = cone(share)
    found, _ = missed_by_sampling(INTERVAL, rates, forces)
    t = INTERVAL * np.arange(N)
    q = integrate_attitude(prepare(t, rates, forces), linear_rate(np.eye(3), np.zeros(3)))
    drift = np.polyfit(t, log(q), 1)[0]  # it should be zero
    np.testing.assert_allclose(found, -drift, rtol=0.05, atol=0.01 * np.abs(drift).max())


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_sculling_by_sampled_integrals_is_wrong_by_what_is_missed(share):
    """The integral of a sine by polynomials through six samples is too small by a factor in closed form."""
    turned, rates, forces = cone(share)
    _, found = missed_by_sampling(INTERVAL, rates, forces)
    x = 2.0 * np.pi * share
    weighted = 802.0 * np.cos(0.5 * x) - 93.0 * np.cos(1.5 * x) + 11.0 * np.cos(2.5 * x)
    of_samples = x * weighted / 1440.0 / np.sin(0.5 * x)
    sculling = np.cross(turned, forces).mean(axis=0)
    # what the cone turns by, a hundredth of a radian, turns the vibration too
    np.testing.assert_allclose(found, (1.0 - of_samples) * sculling, atol=0.02 * np.abs(sculling).max())


def test_slow_motion_and_noise_miss_nothing():
    _, rates, forces = cone(0.02, amplitude=1.0)
    for found in missed_by_sampling(INTERVAL, rates, forces):
        assert np.abs(found).max() < 1e-12
    noise = np.random.default_rng(2).normal(size=(2, N, 3)) * 1e-3
    rate, _ = missed_by_sampling(INTERVAL, *noise)
    assert np.abs(rate).max() < 1e-10


@pytest.mark.parametrize("share", [0.12, 0.2, 0.45])
def test_the_bounds_are_bounds(share):
    _, rates, forces = cone(share, noise=0.01)
    bounds = most_missed(INTERVAL, rates, forces)
    for bound, found in zip(bounds, missed_by_sampling(INTERVAL, rates, forces), strict=True):
        assert np.abs(found).max() < bound


def test_recordings_of_few_samples_say_nothing():
    for found in missed_by_sampling(INTERVAL, np.ones((100, 3)), np.ones((100, 3))):
        assert not found.any()

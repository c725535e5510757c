"""Means of rounded readings against their true errors, drawn; and channels that are held at zero."""

import numpy as np
import pytest

from kreisel.static.rounding import mean_of_truncated, motion_noise_if_silent, rounding_variance

N = 4000


def standing_still(true, noise, step, seed=0):
    """Return readings (n, 3) of one standstill after the other, their parts, and their means."""
    rng = np.random.default_rng(seed)
    values = np.repeat(true, N, axis=0)
    values = values + noise * rng.normal(size=values.shape)
    if step:
        values = step * np.round(values / step)
    parts = [(k * N, (k + 1) * N) for k in range(len(true))]
    return values, parts, np.array([values[a:b].mean(axis=0) for a, b in parts])


@pytest.mark.parametrize("noise", [0.02, 0.2, 0.3])
def test_the_variance_is_that_of_the_errors_of_means(noise):
    """In steps of one, at true values far from each other, so that none errs as another."""
    true = np.random.default_rng(1).uniform(-0.5, 0.5, (60, 3)) + 3.0 * np.arange(60)[:, None]
    values, parts, means = standing_still(true, noise, 1.0)
    error = np.mean((means - true) ** 2)
    assert rounding_variance(values, parts, means).mean() == pytest.approx(error, rel=0.25)


def test_noise_larger_than_a_step_averages_out():
    values, parts, means = standing_still(np.zeros((5, 3)), 1.5, 1.0)
    assert rounding_variance(values, parts, means).max() < 1e-9


def test_standstills_with_the_same_mean_err_alike():
    """Their average has the variance of one."""
    values, parts, means = standing_still(np.full((8, 3), 0.3), 0.01, 1.0)
    values = np.concatenate([values, np.round(np.random.default_rng(1).uniform(-9.0, 9.0, (N, 3)))])
    np.testing.assert_allclose(rounding_variance(values, parts, means), 8.0 / 12.0, rtol=0.01)


def test_readings_that_are_not_rounded_have_none():
    values, parts, means = standing_still(np.zeros((5, 3)), 0.1, 0.0)
    np.testing.assert_array_equal(rounding_variance(values, parts, means), 0.0)


@pytest.mark.parametrize("rest", [0.0, 0.3], ids=["always", "mostly"])
def test_rates_held_at_zero_may_be_as_large_as_the_least_that_is_not(rest):
    rng = np.random.default_rng(2)
    true = rest * np.ones((4, 3))
    values, parts, _ = standing_still(true, 0.1, 0.0)
    moving = rng.uniform(-20.0, 20.0, (N, 3))
    every = np.concatenate([values, moving])
    every[np.abs(every) < 0.5] = 0.0
    means = np.array([every[a:b].mean(axis=0) for a, b in parts])
    variance = rounding_variance(every, parts, means).mean() / len(parts)
    assert variance == pytest.approx(0.5**2 / 3.0, rel=0.1)
    assert rest**2 < 4.0 * variance


def test_a_channel_that_never_changes_has_no_step():
    values = np.zeros((N, 3))
    np.testing.assert_array_equal(rounding_variance(values, [(0, N)], np.zeros((1, 3))), 0.0)


@pytest.mark.parametrize(("step", "silent"), [(0.0, True), (0.01, True), (1.0, False)])
def test_zeros_at_rest_are_those_of_a_silent_device_if_noise_would_carry_them_over_a_step(step, silent):
    rng = np.random.default_rng(3)
    sweep = np.cumsum(rng.normal(0.0, 0.01, (2 * N, 3)), axis=0)
    values = np.concatenate([np.zeros((N, 3)), sweep + rng.normal(0.0, 0.1, sweep.shape)])
    values = step * np.round(values / step) if step else values
    noise = motion_noise_if_silent(values, [(0, N)])
    assert (noise is not None) == silent
    if silent:
        np.testing.assert_allclose(noise, 0.1, rtol=0.35)


def test_few_zeros_at_rest_are_not_those_of_a_silent_device():
    rng = np.random.default_rng(4)
    values = rng.normal(0.0, 0.1, (2 * N, 3))
    values[: N // 2] = 0.0
    assert motion_noise_if_silent(values, [(0, N)]) is None


@pytest.mark.parametrize("mean", [0.0, 0.3, 0.7, 1.1, -1.6])
@pytest.mark.parametrize("noise", [0.6, 1.0, 2.0])
def test_means_of_truncated_noise_err_as_their_variance_says(mean, noise):
    rng = np.random.default_rng(5)
    found = [mean_of_truncated(0.01 * np.trunc(mean + noise * rng.normal(size=500)), 0.01) for _ in range(200)]
    errors = np.array([(one / 0.01 - mean) / np.sqrt(variance) * 0.01 for one, variance in found])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.17)
    assert np.sqrt(found[0][1]) < 0.1 * 0.01


@pytest.mark.parametrize("mean", [0.0, 0.5, -0.9])
def test_a_mean_that_noise_carries_over_no_step_is_unknown_between_them(mean):
    rng = np.random.default_rng(6)
    found, variance = mean_of_truncated(np.trunc(mean + 0.1 * rng.normal(size=500)), 1.0)
    assert variance == pytest.approx(1.0 / 3.0)
    assert abs(found - mean) < 2.0 * np.sqrt(variance)

"""Cauchy weights and the scale they are measured by, against the distributions they stand for."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import chi, norm

from kreisel.estimation.robust import MEDIAN_LENGTH, cauchy_weights, normal_scale, vector_scale

COUNT = 20_000


def lengths_of(rng, sd, n=COUNT):
    return np.linalg.norm(rng.normal(0.0, sd, (n, 3)), axis=1)


def relative_sd_of_the_median(n):
    """Of n lengths: 1 / (2 density sqrt(n)), by their median."""
    median = chi(3).median()
    return 1.0 / (2.0 * chi(3).pdf(median) * np.sqrt(n)) / median


def test_the_median_length_is_that_of_a_chi_variable():
    assert pytest.approx(chi(3).median(), abs=5e-4) == MEDIAN_LENGTH


@pytest.mark.parametrize("sd", [1e-3, 7.0])
def test_outliers_hardly_change_the_scale_of_normal_values(sd):
    at = norm.ppf((np.arange(COUNT) + 0.5) / COUNT) * sd  # quantiles, instead of numbers drawn
    assert normal_scale(at) == pytest.approx(sd, rel=1e-4)
    at[::50] = 1e6 * sd
    assert normal_scale(at.reshape(-1, 2)) == pytest.approx(sd, rel=0.05)


@pytest.mark.parametrize("sd", [1e-3, 7.0])
def test_the_scale_is_the_deviation_of_each_axis(sd):
    found = vector_scale(lengths_of(np.random.default_rng(1), sd))
    assert found == pytest.approx(sd, rel=4.0 * relative_sd_of_the_median(COUNT))


def test_lengths_far_off_move_the_scale_no_further_than_their_share():
    """A tenth of the lengths far away: the median of all is the quantile 5/9 of those that fit."""
    length = lengths_of(np.random.default_rng(2), 1.0)
    length[: COUNT // 10] = 1e6
    expected = chi(3).ppf(5.0 / 9.0) / chi(3).median()
    assert vector_scale(length) == pytest.approx(expected, rel=4.0 * relative_sd_of_the_median(COUNT))


def test_weights_are_one_at_zero_and_a_half_at_the_scale():
    np.testing.assert_allclose(cauchy_weights(np.array([0.0, 2.0, -2.0, 6.0]), 2.0), [1.0, 0.5, 0.5, 0.1], rtol=1e-15)


def test_a_weighted_residual_is_the_slope_of_the_cauchy_likelihood():
    r, scale, h = np.linspace(-20.0, 20.0, 81), 1.7, 1e-5

    def loss(x):
        return 0.5 * scale**2 * np.log1p((x / scale) ** 2)

    slope = (loss(r + h) - loss(r - h)) / (2.0 * h)
    np.testing.assert_allclose(cauchy_weights(r, scale) * r, slope, atol=1e-8)


def test_reweighting_ends_at_the_most_likely_value():
    x = np.concatenate([np.random.default_rng(4).normal(3.0, 1.0, 200), np.full(30, 80.0)])
    mean = float(np.median(x))
    for _ in range(100):
        weight = cauchy_weights(x - mean, 2.0)
        mean = float(weight @ x / weight.sum())
    best = minimize_scalar(lambda m: np.log1p(((x - m) / 2.0) ** 2).sum(), bounds=(0.0, 6.0), method="bounded").x
    assert mean == pytest.approx(best, abs=1e-4)
    assert mean == pytest.approx(3.0, abs=4.0 * np.sqrt(2.0 / 200))  # 80 hardly counts

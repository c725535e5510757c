"""Factors of covariances against the covariances themselves."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kreisel._kernels import triangular

sizes = st.integers(3, 24)
seeds = st.integers(0, 2**32 - 1)


def factor(n, seed):
    """Return a transposed lower triangular factor (n, n) with a positive diagonal."""
    A = np.random.default_rng(seed).normal(size=(n, n))
    return np.linalg.cholesky(A @ A.T + 1e-3 * np.eye(n)).T.copy()


@given(sizes, seeds, st.integers(1, 7))
def test_inflated_degrees_gain_variance(n, seed, k):
    rng = np.random.default_rng(seed)
    upper, degrees = factor(n, seed), np.sort(rng.permutation(n)[: min(k, n)])
    deviations = rng.uniform(0.0, 2.0, degrees.size)
    expected = upper.T @ upper
    expected[degrees, degrees] += deviations**2
    triangular.inflate(upper, degrees, deviations)
    np.testing.assert_allclose(upper.T @ upper, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert not np.tril(upper, -1).any()
    assert (np.diag(upper) >= 0.0).all()


@given(sizes, seeds)
def test_renewed_degrees_are_independent_of_all_others(n, seed):
    first = np.random.default_rng(seed).integers(0, n - 2)
    upper = factor(n, seed)
    expected = upper.T @ upper
    d = slice(first, first + 3)
    expected[d], expected[:, d] = 0.0, 0.0
    expected[d, d] = 0.25 * np.eye(3)
    triangular.renew(upper, int(first), 0.5)
    np.testing.assert_allclose(upper.T @ upper, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert not np.tril(upper, -1).any()


def test_nothing_added_to_a_singular_factor_changes_nothing():
    upper = np.zeros((4, 4))
    triangular.inflate(upper, np.array([1]), np.zeros(1))
    np.testing.assert_array_equal(upper, 0.0)

"""The engine on problems with answers known otherwise: linear ones, and layouts with rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel._kernels.filter_arguments import Gaussian
from kreisel.errors import SettingsError
from kreisel.estimation.belief import Belief, inflate_variance, renew, triangularise
from kreisel.estimation.consistency import correlation_time, mean_normalised, normalised_bounds
from kreisel.estimation.sigma_points import WEIGHTS, weights
from kreisel.estimation.state import Part, StateLayout

from ...kernel_parts import sigma_points


@pytest.mark.parametrize("name", list(WEIGHTS))
@pytest.mark.parametrize("gate", [np.inf, 0.0])
def test_linear_problems_give_the_kalman_filter(name, gate):
    """x' = F x + noise, z = H x' + noise; with the gate closed, the prediction alone."""
    rng = np.random.default_rng(1)
    n, m, changing, k = 6, 3, 2, 2
    F = np.eye(n)
    F[-changing:] += rng.normal(0, 0.3, (changing, n))
    H, R = rng.normal(size=(m, n)), np.diag(rng.uniform(0.1, 0.5, m))
    noise = rng.normal(0, 0.2, (changing, k))
    Q = np.vstack([np.zeros((n - changing, k)), noise])
    A = rng.normal(size=(n, n))
    P, x, z = A @ A.T, rng.normal(size=n), rng.normal(size=m)
    layout = StateLayout([Part("held", n - changing), Part("moving", changing)])
    w = weights(name, n)
    figures = np.array([w.spread, w.mean, w.second, w.shift, w.centre])
    mean, upper = belief = Gaussian(x.copy(), np.linalg.cholesky(P).T.copy())
    points = F @ sigma_points.sample(layout.table, belief, w.spread)
    seen, seen_noise = H @ (points - points[:, :1]), np.hstack([H @ Q, -H @ Q])
    used, nis, factor, whitened, gain = sigma_points.update(
        layout.table, layout.tail(changing).table, figures, belief, points, noise, seen, seen_noise,
        z - H @ points[:, 0], R, gate,
    )  # fmt: skip

    P1 = F @ P @ F.T + Q @ Q.T
    S = H @ P1 @ H.T + R @ R.T
    K = P1 @ H.T @ np.linalg.inv(S)
    assert used == (gate > 0.0)
    assert nis == pytest.approx(whitened @ whitened)
    np.testing.assert_allclose(factor @ factor.T, S, atol=1e-9)
    np.testing.assert_allclose(factor @ whitened, z - H @ F @ x, atol=1e-9)
    np.testing.assert_allclose(gain @ factor.T, P1 @ H.T, atol=1e-9)
    np.testing.assert_allclose(mean, F @ x + (K @ (z - H @ F @ x) if used else 0.0), atol=1e-9)
    np.testing.assert_allclose(upper.T @ upper, P1 - (K @ S @ K.T if used else 0.0), atol=1e-9)
    assert np.all(np.tril(upper, -1) == 0.0)


@given(st.integers(1, 8), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_triangularise_keeps_the_product(n, k, seed):
    columns = np.random.default_rng(seed).normal(size=(n, k))
    lower = triangularise(columns)
    np.testing.assert_allclose(lower @ lower.T, columns @ columns.T, atol=1e-12)
    assert np.all(np.triu(lower, 1) == 0.0)
    assert np.all(np.diag(lower) >= 0.0)


LAYOUT = StateLayout([Part("a", 2), Part("turn", 3, rotation=True), Part("tilt", 2, rotation=True), Part("b", 1)])
changes = st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8).map(np.array)


@given(changes)
def test_minus_undoes_plus(change):
    x = LAYOUT.plus(np.array([1.0, 2, 0.5, 0.5, 0.5, 0.5, 1, 0, 0, 0, 3]), np.zeros((8, 1)))[:, 0].copy()
    moved = LAYOUT.plus(x, change[:, None])
    np.testing.assert_allclose(LAYOUT.minus(moved, x)[:, 0], change, atol=1e-14)


def test_layout_names_slices():
    assert LAYOUT.degrees == 8
    assert LAYOUT.size == 11
    assert LAYOUT["tilt"] == slice(5, 7)
    assert LAYOUT.stored("b") == slice(10, 11)
    assert "tilt" in LAYOUT
    assert "yaw" not in LAYOUT


def test_sigma_points_have_the_beliefs_spread():
    rng = np.random.default_rng(0)
    mean, factor = rng.normal(size=4), np.tril(rng.normal(size=(4, 4)))
    points = sigma_points.sample(StateLayout([Part("x", 4)]).table, Gaussian(mean, factor.T.copy()), 2.0)
    spread = points[:, 1:] - mean[:, None]
    np.testing.assert_allclose(spread @ spread.T / (2 * 2.0**2), factor @ factor.T, atol=1e-12)


def test_renewed_part_is_independent():
    rng = np.random.default_rng(0)
    layout = StateLayout([Part("x", 3), Part("y", 2)])
    belief = Belief(rng.normal(size=5), np.linalg.cholesky(np.eye(5) + 0.3))
    fresh = renew(layout, belief, "x", np.zeros(3), 2.0)
    P = fresh.covariance
    np.testing.assert_allclose(P[:3, :3], 4.0 * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(P[:3, 3:], 0.0, atol=1e-12)
    np.testing.assert_allclose(P[3:, 3:], belief.covariance[3:, 3:], atol=1e-12)


def test_widened_part_gains_variance():
    layout = StateLayout([Part("x", 3), Part("y", 2)])
    belief = Belief(np.zeros(5), np.linalg.cholesky(np.eye(5) + 0.3))
    more = inflate_variance(layout, belief, "x", 2.0).covariance - belief.covariance
    np.testing.assert_allclose(more, np.diag([4.0, 4.0, 4.0, 0.0, 0.0]), atol=1e-12)


def test_unknown_weights_list_the_known_ones():
    with pytest.raises(SettingsError, match="central-difference"):
        weights("cubic", 3)


def test_correlation_time_of_an_autoregression():
    """AR(1) with coefficient 0.8 has the integrated time (1 + 0.8) / (1 - 0.8) = 9."""
    rng = np.random.default_rng(2)
    x = np.zeros(40_000)
    for k in range(1, x.size):
        x[k] = 0.8 * x[k - 1] + rng.normal()
    assert correlation_time(x) == pytest.approx(9.0, rel=0.12)  # its standard error is about 4 %
    assert correlation_time(rng.normal(size=40_000)) == pytest.approx(1.0, abs=0.1)


def test_nis_bounds_hold_ninety_five_per_cent():
    rng = np.random.default_rng(3)
    low, high = normalised_bounds(np.full(50, 6.0))
    means = [mean_normalised(rng.chisquare(6, 50), np.full(50, 6.0)) for _ in range(4000)]
    assert np.mean([low < mean < high for mean in means]) == pytest.approx(0.95, abs=0.015)

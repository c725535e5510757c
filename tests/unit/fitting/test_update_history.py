"""What an update is worth once parameters were fitted to the same data before."""

import numpy as np
import pytest

from kreisel.fitting.fit import Fit

from ...small_problem import history


def run_of(nis_degrees, fitted, used=None):
    degrees = np.asarray(nis_degrees, dtype=float)
    made = history(degrees.size, degrees=degrees, **({} if used is None else {"used": np.asarray(used)}))
    return Fit(None, None, None, made, fitted)


def test_the_excess_makes_residuals_of_a_fit_as_large_as_the_noise():
    """Least squares: the squared residuals of m equations and k unknowns are (m - k) sigma^2 in the mean.

    The sum over 400 fits of 48 residuals less 12 has a relative deviation of sqrt(2 / (400 * 36)) = 1.2 %.
    """
    rng, m, k = np.random.default_rng(0), 48, 12
    H = rng.normal(size=(m, k))
    hat = H @ np.linalg.solve(H.T @ H, H.T)
    y = rng.normal(size=(m, 400))
    nis = np.mean(np.sum((y - hat @ y) ** 2, axis=0)) / m
    excess = run_of([6.0] * (m // 6), float(k)).excess
    assert excess == pytest.approx(48.0 / 36.0, rel=1e-14)
    assert excess * nis == pytest.approx(1.0, abs=5 * 0.012)


def test_only_updates_that_were_used_leave_degrees_of_freedom():
    assert run_of([6.0, 9.0, 6.0], 3.0, [True, False, True]).excess == pytest.approx(12.0 / 9.0)


def test_nothing_fitted_before_is_no_excess():
    assert run_of([6.0, 9.0], 0.0).excess == 1.0


def test_without_updates_there_is_no_excess():
    assert run_of([], 5.0).excess == 1.0
    assert run_of([6.0, 6.0], 5.0, [False, False]).excess == 1.0


def test_more_parameters_than_data_do_not_make_the_excess_endless():
    assert run_of([6.0] * 10, 1e3).excess == pytest.approx(1.0 / 0.3)

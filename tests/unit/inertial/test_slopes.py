"""Derivatives of local cubics: against polynomials, SciPy's filter and closed forms of noise and error."""

import numpy as np
import pytest
from scipy.signal import savgol_coeffs

from kreisel.inertial.slopes import LONGEST_GAP, SAMPLES, local_cubics, run_starts, usual_interval

H = 0.0025


def test_of_a_cubic_both_derivatives_are_exact_at_any_stamps():
    t = np.cumsum(np.random.default_rng(1).uniform(0.3, 1.7, 300)) * H
    cubics = local_cubics(t, H)
    x = np.column_stack([1.0 + 2.0 * t - 3.0 * t**2 + 40.0 * t**3, -t])
    np.testing.assert_allclose(
        cubics.slopes(x), np.column_stack([2.0 - 6.0 * t + 120.0 * t**2, -np.ones(300)]), atol=1e-10
    )
    np.testing.assert_allclose(cubics.curvatures(x)[:, 0], -6.0 + 240.0 * t, atol=1e-7)


@pytest.mark.parametrize("order", [1, 2])
def test_at_equal_intervals_the_weights_are_those_of_savitzky_and_golay(order):
    cubics = local_cubics(H * np.arange(100), H)
    want = savgol_coeffs(SAMPLES, 3, deriv=order, delta=H, use="dot")
    np.testing.assert_allclose((cubics.slope, cubics.curvature)[order - 1][50], want, atol=1e-9 * np.abs(want).max())


def test_noise_and_error_are_as_stated():
    t = H * np.arange(400)
    cubics = local_cubics(t, H)
    assert np.linalg.norm(cubics.slope[200]) * H == pytest.approx(0.51, abs=0.005)
    w = 2.0 * np.pi * 3.0
    missed = cubics.slopes(np.sin(w * t)[:, None])[3:-3, 0] - w * np.cos(w * t)[3:-3]
    assert np.abs(missed).max() / w == pytest.approx(131.0 / 630.0 * (w * H) ** 4, rel=0.005)


def test_no_cubic_reaches_across_a_gap():
    t = H * np.arange(40) + np.where(np.arange(40) >= 20, 1.0, 0.0)
    x = np.where(np.arange(40) >= 20, 1e3, 0.0)[:, None] + t[:, None]
    np.testing.assert_allclose(local_cubics(t, H).slopes(x), 1.0, rtol=1e-9)
    assert run_starts(t, H).tolist() == [20]


@pytest.mark.parametrize(("count", "degree"), [(1, 0), (2, 1), (3, 2), (4, 3), (6, 3)])
def test_a_short_run_has_the_derivatives_of_a_polynomial_of_lower_degree(count, degree):
    first, short = H * np.arange(20), 5.0 + H * np.arange(count)
    t = np.concatenate([first, short, 9.0 + first])
    values = (t - 5.0) ** degree if degree else np.ones_like(t)
    found = local_cubics(t, H).slopes(values[:, None])[20 : 20 + count, 0]
    want = degree * (short - 5.0) ** (degree - 1) if degree else np.zeros(count)
    np.testing.assert_allclose(found, want, atol=1e-9)


def test_slow_sensors_have_longer_gaps():
    t = 0.04 * np.arange(30)
    assert usual_interval(t) == pytest.approx(0.04)
    assert run_starts(t[[0, 1, 2, 5, 6, 7]], 0.04).size == 0
    assert run_starts(t[[0, 1, 2, 8, 9]], 0.04).tolist() == [3]
    assert run_starts(np.array([0.0, 0.9 * LONGEST_GAP, 2.0 * LONGEST_GAP]), 1e-3).tolist() == [2]

"""Integrals and derivatives of sampled signals: exact for the polynomials they stand for, on uneven stamps."""

import numpy as np
import pytest

from kreisel._kernels.quadrature import double_integral, interpolate
from kreisel.inertial.strapdown import prepare


@pytest.fixture
def stamps():
    return np.cumsum(np.random.default_rng(0).uniform(0.003, 0.007, 60))


def signal(stamps, values):
    return prepare(stamps, values, values)


def test_quintics_are_integrated_exactly(stamps):
    c = np.random.default_rng(1).normal(size=(3, 6))
    t = stamps - stamps.mean()
    s = signal(stamps, np.stack([np.polyval(c[i], t) for i in range(3)], axis=1))
    exact = np.stack([np.polyval(np.polyint(c[i]), t) for i in range(3)], axis=1)
    np.testing.assert_allclose(s.integrals, np.diff(exact, axis=0), atol=1e-15)
    twice = np.stack([np.polyval(np.polyint(c[i], 2), t) for i in range(3)], axis=1)
    dt = np.diff(t)[:, None]
    double = np.einsum("ki,kic->kc", s.samples.twice, s.rates[s.samples.base[:, None] + np.arange(6)])
    np.testing.assert_allclose(double, np.diff(twice, axis=0) - exact[:-1] * dt, atol=1e-16)


def test_quartics_are_differentiated_exactly(stamps):
    c = np.array([1.0, -3, 2, 5, 4])
    t = stamps - stamps.mean()
    s = signal(stamps, np.repeat(np.polyval(c, t)[:, None], 3, axis=1))
    np.testing.assert_allclose(s.slopes[:, 0], np.polyval(np.polyder(c), t), atol=1e-10)


def test_even_stamps_give_the_known_weights():
    s = signal(np.arange(10.0), np.zeros((10, 3)))
    # Newton-Cotes' weights for the middle of six points
    np.testing.assert_allclose(s.samples.single[4], np.array([11, -93, 802, 802, -93, 11]) / 1440, atol=1e-14)


def test_segments_do_not_look_across_a_gap():
    t = np.concatenate([np.arange(10.0), 100.0 + np.arange(10.0)])
    values = np.concatenate([np.zeros((10, 3)), np.full((10, 3), 1e6)])
    s = prepare(t, values, values, segments=((0, 9), (10, 19)))
    assert np.all(s.integrals[:9] == 0.0)
    assert np.all(s.slopes[:10] == 0.0)
    np.testing.assert_allclose(s.integrals[10:], 1e6)


def test_double_integral_of_a_broken_line():
    """Linear between uneven stamps: at the samples exactly what twice the trapezoidal rule gives."""
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.5, 1.5, 50))
    values = rng.normal(size=(50, 3))
    once = np.vstack([np.zeros(3), np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t)[:, None], axis=0)])
    twice = np.vstack([np.zeros(3), np.cumsum(0.5 * (once[1:] + once[:-1]) * np.diff(t)[:, None], axis=0)])
    moments = np.sort(rng.uniform(t[0], t[-1], 30))
    before = np.searchsorted(t, moments, side="right") - 1
    out = np.empty((30, 3))
    double_integral(t, values, before, (moments - t[before]) / np.diff(t)[before], out)
    for axis in range(3):
        np.testing.assert_allclose(out[:, axis], np.interp(moments, t, twice[:, axis]), atol=1e-12)


@pytest.mark.parametrize("count", [4, 60])
def test_cubics_are_interpolated_exactly(stamps, count):
    """Also before the first sample and after the last; at a sample, the sample."""
    t = stamps[:count] - stamps[0]
    cubics = np.random.default_rng(5).normal(size=(7, 4))
    values = np.column_stack([np.polyval(c, t) for c in cubics])
    moments = np.sort(np.concatenate([t, np.random.default_rng(6).uniform(t[0] - 0.003, t[-1] + 0.003, 200)]))
    out, after = np.empty((moments.size, 7)), np.empty(moments.size, dtype=np.int64)
    interpolate(t, values, moments, after, out)
    np.testing.assert_allclose(out, np.column_stack([np.polyval(c, moments) for c in cubics]), atol=1e-13)
    np.testing.assert_array_equal(after, np.clip(np.searchsorted(t, moments, side="right"), 1, count - 1))
    np.testing.assert_allclose(out[np.searchsorted(moments, t)], values, atol=1e-15)


def test_the_four_samples_around_a_moment_count_and_no_others(stamps):
    values, middle = np.zeros((60, 1)), 0.5 * (stamps[29] + stamps[30])
    out, after = np.empty((1, 1)), np.empty(1, dtype=np.int64)
    for k in range(60):
        values[:] = 0.0
        values[k] = 1.0
        interpolate(stamps, values, np.array([middle]), after, out)
        assert (out[0, 0] != 0.0) == (28 <= k <= 31)
    with pytest.raises(ValueError, match="a cubic needs four samples, got 3"):
        interpolate(stamps[:3], values[:3], np.array([middle]), after, out)

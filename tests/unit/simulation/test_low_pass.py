"""Splines and the low-pass against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.signal import bilinear, lfilter, lfilter_zi

from kreisel.simulation.controller import _exponential
from kreisel.simulation.low_pass import FINER, averaged, low_passed


@pytest.mark.parametrize("count", [4, 5, 6, 40, 1000])
def test_means_are_those_of_the_spline(count):
    values = np.random.default_rng(count).normal(size=(count, 3))
    integral = CubicSpline(np.arange(count), values).antiderivative()(np.arange(count))
    out = averaged(values)
    np.testing.assert_array_equal(out[0], values[0])
    np.testing.assert_allclose(out[1:], np.diff(integral, axis=0), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("count", "rate", "bandwidth"), [(4, 200.0, 40.0), (900, 200.0, 0.5), (900, 1000.0, 80.0)])
def test_the_low_pass_is_scipys(count, rate, bandwidth):
    values = np.random.default_rng(count).normal(size=(count, 3))
    fine = CubicSpline(np.arange(count), values)(np.arange((count - 1) * FINER + 1) / FINER)
    pole = 2.0 * np.pi * bandwidth
    b, a = bilinear([pole**2], [1.0, np.sqrt(2.0) * pole, pole**2], fs=rate * FINER)
    expected, _ = lfilter(b, a, fine, axis=0, zi=lfilter_zi(b, a)[:, None] * fine[0])
    np.testing.assert_allclose(low_passed(values, rate, bandwidth), expected[::FINER], rtol=0, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-8, 0.3, 5.0, 60.0])
def test_the_exponential_is_scipys(size):
    M = size * np.random.default_rng(3).normal(size=(4, 4))
    np.testing.assert_allclose(_exponential(M), expm(M), rtol=1e-10 * max(1.0, size), atol=1e-14)

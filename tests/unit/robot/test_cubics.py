"""Piecewise polynomials against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import PPoly

from kreisel.robot.cubics import Piecewise


@pytest.fixture(scope="module")
def both():
    rng = np.random.default_rng(1)
    breaks, coefficients = np.cumsum(rng.uniform(0.1, 1.0, 9)), rng.normal(size=(8, 4))
    return Piecewise(breaks, coefficients), PPoly(coefficients.T, breaks, extrapolate=True)


@pytest.mark.parametrize("step", ["itself", "derivative", "second derivative", "antiderivative"])
def test_values_are_those_of_scipy(both, step):
    own, other = both
    if step == "antiderivative":
        own, other = own.antiderivative(), other.antiderivative()
    elif step != "itself":
        times = 2 if step.startswith("second") else 1
        other = other.derivative(times)
        for _ in range(times):
            own = own.derivative()
    t = np.concatenate([np.linspace(-1.0, 8.0, 1001), own.breaks])
    np.testing.assert_allclose(own(t), other(t), rtol=1e-12, atol=1e-11)

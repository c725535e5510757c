"""Exponential and logarithm of rigid motions against the matrix exponential."""

import numpy as np
import pytest
from scipy.linalg import expm

from kreisel.geometry.pose import exp_motion, log_motion
from kreisel.geometry.rotation import skew


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9e-4, 1.1e-3, 0.3, 2.0, 3.1415926])
def test_there_and_back(angle):
    axis = np.array([0.6, -0.48, 0.64])
    xi = np.concatenate([[0.3, -2.0, 1.0], angle * axis])
    M = np.zeros((4, 4))
    M[:3, :3], M[:3, 3] = skew(xi[3:]), xi[:3]
    expected = expm(M)
    C, p = exp_motion(xi)
    np.testing.assert_allclose(C, expected[:3, :3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(p, expected[:3, 3], rtol=0, atol=1e-9 if angle < 0.1 else 1e-13)
    np.testing.assert_allclose(log_motion(C, p), xi, rtol=0, atol=1e-8)

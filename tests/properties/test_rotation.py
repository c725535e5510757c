"""Group laws, exponential and logarithm; almost-zero rotations included."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kreisel.geometry.rotation import (
    apply,
    conjugate,
    exp,
    from_matrix,
    from_two_vectors,
    log,
    matrix,
    multiply,
    nearest_rotation,
)

from ..kernel_parts import rotation as kernels

EPS = np.finfo(float).eps
component = st.one_of(st.floats(-1.8, 1.8), st.floats(-1e-9, 1e-9), st.sampled_from([0.0, 1e-160, -1e-300]))
vectors = st.tuples(component, component, component).map(np.array)


@given(vectors)
def test_log_undoes_exp(theta):
    if np.linalg.norm(theta) < np.pi - 1e-6:
        np.testing.assert_allclose(log(exp(theta)), theta, rtol=0, atol=20 * EPS)


@given(vectors)
def test_exp_is_scipys(theta):
    expected = Rotation.from_rotvec(theta).as_matrix()
    np.testing.assert_allclose(matrix(exp(theta)), expected, atol=20 * EPS)


@given(vectors, vectors, vectors)
def test_products_and_actions(a, b, v):
    p, q = exp(a), exp(b)
    np.testing.assert_allclose(apply(multiply(p, q), v), apply(p, apply(q, v)), atol=50 * EPS)
    np.testing.assert_allclose(multiply(p, conjugate(p)), [1, 0, 0, 0], atol=10 * EPS)
    np.testing.assert_allclose(apply(p, v), matrix(p) @ v, atol=50 * EPS)


@given(vectors)
def test_matrix_and_back(theta):
    q = exp(theta)
    assert abs(abs(from_matrix(matrix(q)) @ q) - 1.0) < 20 * EPS


@given(vectors, vectors)
@example(np.array([0.0, 0.5, 5.96e-8]), np.array([0.0, -1.0, 0.0]))
def test_shortest_turn(a, b):
    if np.linalg.norm(a) > 1e-3 and np.linalg.norm(b) > 1e-3:
        turned = apply(from_two_vectors(a, b), a / np.linalg.norm(a))
        np.testing.assert_allclose(turned, b / np.linalg.norm(b), atol=1e-7)


def test_opposite_vectors_have_a_turn():
    np.testing.assert_allclose(apply(from_two_vectors([1.0, 0, 0], [-1.0, 0, 0]), [1.0, 0, 0]), [-1, 0, 0], atol=1e-12)


def test_nearest_rotation_is_proper():
    R = nearest_rotation(np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(vectors, vectors)
def test_kernels_agree_with_the_plain_form(a, b):
    q = exp(a)
    turned = kernels.plus(q[:, None], b[:, None])
    np.testing.assert_allclose(turned[:, 0], multiply(q, exp(b)), atol=10 * EPS)
    if np.linalg.norm(b) < np.pi - 1e-6:
        np.testing.assert_allclose(kernels.minus(turned, q)[:, 0], b, atol=30 * EPS)


@given(vectors)
def test_series_of_the_step_is_exact_below_one_radian(theta):
    theta = theta / max(1.0, 1.001 * float(np.linalg.norm(theta)))
    q = kernels.plus(np.array([[1.0], [0.0], [0.0], [0.0]]), theta[:, None])
    np.testing.assert_allclose(q[:, 0], exp(theta), atol=4 * EPS)

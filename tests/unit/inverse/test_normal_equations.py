"""Sums over rows, and their solution, against dense least squares."""

import numpy as np
import pytest
from numpy.linalg import LinAlgError

from kreisel.inverse.normal_equations import POINT, WIDTH, NormalEquations, Rows

POINTS, PARAMETERS, ROWS = 12, 3, 2


def some_rows(rng, local):
    span = np.sort(rng.integers(0, POINTS - 5, 90))
    return span, rng.normal(size=(90, ROWS, WIDTH)), rng.normal(size=(90, ROWS, local)), rng.normal(size=(90, ROWS))


def dense(span, by_points, by_parameters, residual, columns):
    J = np.zeros((*residual.shape, POINTS * POINT + PARAMETERS))
    for i, own in enumerate(span):
        J[i, :, POINT * own : POINT * own + WIDTH] = by_points[i]
    J[:, :, POINTS * POINT :] = by_parameters @ columns
    return J.reshape(-1, J.shape[-1]), residual.ravel()


def test_a_solution_is_that_of_dense_least_squares():
    rng = np.random.default_rng(0)
    equations = NormalEquations(POINTS, PARAMETERS)
    parts = []
    for local in (3, 4):
        columns = np.eye(local)[:, :PARAMETERS] + 0.1 * rng.normal(size=(local, PARAMETERS))
        rows = some_rows(rng, local)
        equations.add(Rows(*rows, columns))
        parts.append(dense(*rows, columns))
    J, e = (np.concatenate(part) for part in zip(*parts, strict=True))
    information, pull = np.diag([0.0, 50.0, 2.0]), np.array([0.0, 3.0, -1.0])
    whole = J.T @ J
    whole[-PARAMETERS:, -PARAMETERS:] += information
    side = J.T @ e
    side[-PARAMETERS:] += pull
    wanted = np.linalg.solve(whole, side)
    points, step, covariance = equations.solve(information, pull)
    np.testing.assert_allclose(np.concatenate([points.ravel(), step]), wanted, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(covariance, np.linalg.inv(whole)[-PARAMETERS:, -PARAMETERS:], rtol=1e-8)
    assert equations.squares == pytest.approx(e @ e)


def test_points_without_rows_are_steady():
    """Known at both ends, and a parabola in between: third differences are zero."""
    equations = NormalEquations(POINTS, 1)
    ends = np.array([0, 6])
    by_points = np.tile(np.eye(WIDTH), (2, 1, 1))
    wanted = np.repeat((np.arange(POINTS)[:, None] - 3.0) ** 2, POINT, axis=1)
    residual = np.stack([wanted[i : i + 6].ravel() for i in ends])
    equations.add(Rows(ends, by_points, np.zeros((2, WIDTH, 1)), residual, np.eye(1)))
    equations.steady(1e-6)
    points, _, _ = equations.solve(np.eye(1), np.zeros(1))
    np.testing.assert_allclose(points, wanted, atol=1e-6)
    few = NormalEquations(POINTS, 1)
    few.add(Rows(ends[:1], by_points[:1], np.zeros((1, WIDTH, 1)), residual[:1], np.eye(1)))
    few.steady(1e-6)
    points, _, _ = few.solve(np.eye(1), np.zeros(1))
    np.testing.assert_allclose(points, wanted, atol=1e-3)
    with pytest.raises(LinAlgError):
        NormalEquations(POINTS, 1).solve(np.eye(1), np.zeros(1))

"""Recursions over the slopes of updates, against plain products of matrices."""

import numpy as np
import pytest

from kreisel._kernels.slope_recursions import SlopeTables, SlopeTerms, carry_back, carry_innovations, carry_terms

U, N, C, Q, M = 7, 11, 4, 9, 13


def slopes():
    rng = np.random.default_rng(1)
    return SlopeTables(
        rng.normal(size=(U, C, N)), rng.normal(size=(U, Q, N)), 0.1 * rng.normal(size=(U, Q, N)),
        rng.uniform(size=(U, N)).round(1),
    )  # fmt: skip


def terms(moments=U):
    """Four terms that add to degrees of freedom, three of them of accelerometers, and nine of poses."""
    rng = np.random.default_rng(2)
    place, axis, direction = np.full(M, -1), np.full(M, -1), np.arange(M) - 4
    place[:4], axis[1:4], direction[:4] = [2, 3, 4, 5], range(3), -1
    return SlopeTerms(
        rng.normal(size=(U, 5)), rng.normal(size=(moments, 5)), np.arange(M) % 5, place, direction, axis,
        rng.normal(size=(U, Q, 9)), rng.normal(size=(moments, 3, 3)), rng.normal(size=(moments, Q, 3)), 8,
    )  # fmt: skip


def whole(tables, k):
    """Return the transition of all degrees of freedom over an update."""
    return np.vstack([np.eye(N)[: N - C], tables.transition[k]])


@pytest.mark.parametrize("moments", [U, 0])
def test_terms(moments):
    tables, all_terms = slopes(), terms(moments)
    state, wanted = np.zeros((N, M)), np.zeros((N, M))
    found = carry_terms(tables, all_terms, state)
    for k in range(U):
        values, during = all_terms.functions[k][all_terms.function], np.zeros((N, M))
        during[all_terms.place[:4], np.arange(4)] = values[:4]
        before = tables.keep[k][:, None] * wanted
        wanted = whole(tables, k) @ (before + during)
        wanted[: N - C] -= during[: N - C]
        prediction = tables.design[k] @ (before + during)
        if moments:
            moment = all_terms.moments[k][all_terms.function[1:4]]
            wanted[8:11, 1:4] += all_terms.axes[k] * moment
            prediction[:, 1:4] += all_terms.axes_seen[k] * moment
        prediction[:, 4:] += all_terms.seen[k] * values[4:]
        np.testing.assert_allclose(found[k], prediction, rtol=1e-10, atol=1e-10)
        wanted = wanted - tables.gain[k].T @ prediction
    np.testing.assert_allclose(state, wanted, rtol=1e-10, atol=1e-10)


def test_the_adjoint_of_innovations():
    """The derivative of the last state by an innovation, forward and back."""
    tables, rng = slopes(), np.random.default_rng(3)
    innovations = np.zeros((U, Q, M))
    innovations[2] = rng.normal(size=(Q, M))
    state, weights, back = np.zeros((N, M)), np.zeros((U, Q, N)), np.eye(N)
    closed = tables._replace(design=np.zeros((U, Q, N)))
    carry_innovations(closed, innovations, state)
    ends, begins = carry_back(closed, weights, back, after=np.arange(N), before=np.array([3]))
    np.testing.assert_allclose(state, -np.einsum("qi,qm->im", weights[2], innovations[2]), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(ends[0], (tables.keep[1][:, None] * _before(closed, ends, 1)), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(begins[1, 0], _before(closed, ends, 1)[3], rtol=1e-10, atol=1e-12)


def _before(tables, ends, k):
    return whole(tables, k).T @ ends[k] - tables.design[k].T @ tables.gain[k] @ ends[k]


def test_what_goes_back_are_derivatives_through_predictions():
    tables = slopes()
    back, weights = np.eye(N), np.zeros((U, Q, N))
    ends, begins = carry_back(tables, weights, back, after=np.arange(N), before=np.arange(N))
    for k in range(U):
        np.testing.assert_allclose(begins[k], _before(tables, ends, k), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(weights[k], -tables.gain[k] @ ends[k], rtol=1e-9, atol=1e-9)


def test_tables_that_do_not_fit_are_refused():
    tables, all_terms = slopes(), terms()
    with pytest.raises(ValueError, match="gain"):
        carry_terms(tables._replace(gain=tables.gain[1:]), all_terms, np.zeros((N, M)))
    with pytest.raises(ValueError, match="place"):
        carry_terms(tables, all_terms._replace(place=all_terms.place + N), np.zeros((N, M)))
    with pytest.raises(ValueError, match="state"):
        carry_terms(tables, all_terms, np.zeros((N, M + 1)))

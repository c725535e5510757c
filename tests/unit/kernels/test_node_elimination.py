"""Rows that do not fit together, and equations that nothing solves; solutions are those of test_rest_chain.py."""

import numpy as np
import pytest

from kreisel._kernels.node_elimination import NODE, ChainRows, eliminate

T, P, M = 4, 2, 3


def rows(**changed):
    rng = np.random.default_rng(3)
    own = ChainRows(
        rng.normal(size=(T, 3)), np.array([0, 1, 2, 0]), np.array([1, 2, -1, -1]), rng.normal(size=(T, 3, NODE)),
        rng.normal(size=(T, 3, NODE)), rng.normal(size=(T, 3, P)),
    )  # fmt: skip
    return own._replace(**changed)


def solved(own, nodes=1.0, weights=1.0, alike=2):
    of_nodes = nodes * np.repeat(np.eye(NODE)[None], M, axis=0)
    return eliminate(own, np.full((2, T, 3), weights), alike, of_nodes, np.eye(P, P + 1))


def test_rows_that_are_alike_may_be_any_of_them():
    for alike in range(T + 1):
        for one, other in zip(solved(rows(), alike=alike), solved(rows(), alike=0), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-10)


@pytest.mark.parametrize("how", [{"nodes": 0.0}, {"nodes": -10.0}, {"weights": np.nan}, {"weights": 0.0}])
def test_what_nothing_shows_has_no_evidence(how):
    assert (solved(rows(), **how)[2] == -np.inf).all()


@pytest.mark.parametrize(
    "changed",
    [
        {"next": np.array([2, 2, -1, -1])},
        {"next": np.array([1, 2, 3, -1])},
        {"node": np.array([0, 1, 3, 0])},
        {"residual": np.zeros((T, 2))},
        {"of_next": np.zeros((T, 3, NODE - 1))},
    ],
)
def test_rows_that_do_not_fit_together_are_refused(changed):
    with pytest.raises((ValueError, IndexError)):
        solved(rows(**changed))
    with pytest.raises(ValueError, match="alike"):
        solved(rows(), alike=T + 1)

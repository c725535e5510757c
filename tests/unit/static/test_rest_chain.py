"""Elimination of a chain against one dense system of all its unknowns, and its evidence against a normal density."""

import numpy as np

from kreisel._kernels.node_elimination import NODE
from kreisel.static.rest_chain import Equations, solve


def chain(rng, M=5, P=4):
    """Return two kinds of equations, information before, and the same as dense matrices."""
    own = Equations(
        rng.normal(size=(M, 3)), np.arange(M), rng.normal(size=(M, 3, NODE)), None, rng.normal(size=(M, 3, P))
    )
    at = np.array([0, 1, 3])  # between the third and the fourth there is nothing
    between = Equations(
        rng.normal(size=(3, 3)), at, rng.normal(size=(3, 3, NODE)), rng.normal(size=(3, 3, NODE)),
        rng.normal(size=(3, 3, P)),
    )  # fmt: skip
    nodes = np.stack([np.diag(rng.uniform(0.5, 2.0, NODE)) for _ in range(M)])
    prior, about = np.diag(rng.uniform(0.5, 2.0, P)), rng.normal(size=P)
    J = np.zeros((3 * (M + 3), M * NODE + P))
    for k in range(M):
        J[3 * k : 3 * k + 3, NODE * k : NODE * (k + 1)] = own.of_node[k]
        J[3 * k : 3 * k + 3, -P:] = own.of_parameters[k]
    for k, m in enumerate(at):
        rows = slice(3 * (M + k), 3 * (M + k) + 3)
        J[rows, NODE * m : NODE * (m + 1)] = between.of_node[k]
        J[rows, NODE * (m + 1) : NODE * (m + 2)] = between.of_next[k]
        J[rows, -P:] = between.of_parameters[k]
    r = np.concatenate([own.residual.ravel(), between.residual.ravel()])
    before = np.zeros((J.shape[1],) * 2)
    for m in range(M):
        before[NODE * m : NODE * (m + 1), NODE * m : NODE * (m + 1)] = nodes[m]
    before[-P:, -P:] = prior
    return (own, between), nodes, (prior, prior @ about), about, (J, r, before)


def test_the_chain_is_the_dense_system():
    rng = np.random.default_rng(1)
    equations, nodes, (prior, expected), _, (J, r, before) = chain(rng)
    M, P = 5, 4
    weights = [rng.uniform(0.5, 2.0, (2, M, 3)), rng.uniform(0.5, 2.0, (2, 3, 3))]
    found = solve(equations, weights, nodes, (prior, expected))
    for s in range(2):
        W = np.diag(np.concatenate([weights[0][s].ravel(), weights[1][s].ravel()]))
        H = J.T @ W @ J + before
        x = np.linalg.solve(H, np.concatenate([np.zeros(M * NODE), expected]) - J.T @ W @ r)
        np.testing.assert_allclose(found.parameters[s], x[-P:], rtol=1e-9)
        np.testing.assert_allclose(found.nodes[s].ravel(), x[:-P], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.covariance[s], np.linalg.inv(H)[-P:, -P:], rtol=1e-9)


def test_the_evidence_is_that_of_a_normal_density():
    """The difference of log-evidences for two sets of weights is that of the densities of the sum of all that errs."""
    rng = np.random.default_rng(2)
    equations, nodes, (prior, expected), about, (J, r, before) = chain(rng)
    M = 5
    weights = [rng.uniform(0.5, 2.0, (2, M, 3)), rng.uniform(0.5, 2.0, (2, 3, 3))]
    found = solve(equations, weights, nodes, (prior, expected))
    densities = []
    for s in range(2):
        W = np.diag(np.concatenate([weights[0][s].ravel(), weights[1][s].ravel()]))
        S = np.linalg.inv(W) + J @ np.linalg.inv(before) @ J.T
        left = r + J @ np.concatenate([np.zeros(M * NODE), about])
        densities.append(-0.5 * left @ np.linalg.solve(S, left) - 0.5 * np.linalg.slogdet(S)[1])
    np.testing.assert_allclose(np.diff(found.log_evidence), np.diff(densities), rtol=1e-9)

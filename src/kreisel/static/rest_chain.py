"""Least squares over a chain: unknowns of every standstill, joined to its neighbours, and parameters common to all.

The chain is eliminated from its beginning to its end, which costs as much as there are standstills. All of it is done
for several sets of weights at once, since the noise figures are found by comparing them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from kreisel.geometry.rotation import Array, Indices

NODE = 9
"""Unknowns of a standstill: its attitude (a rotation vector in b), and how far the offsets of gyros and accelerometers
are from their values in the middle of the recording."""

ATTITUDE, GYRO_WALK, ACCEL_WALK = slice(0, 3), slice(3, 6), slice(6, 9)
"""Of the unknowns of a standstill."""


@dataclass(frozen=True)
class Equations:
    """Rows of one kind, three of each of k: residual + J_node x_node + J_next x_(node + 1) + J p = noise.

    Attributes
    ----------
    residual : (k, 3)
    node : (k,)
        Standstill each belongs to, all different.
    of_node, of_next : (k, 3, NODE)
        Derivatives; None where nothing depends on the next standstill.
    of_parameters : (k, 3, P)
    """

    residual: Array
    node: Indices
    of_node: Array
    of_next: Array | None
    of_parameters: Array


@dataclass(frozen=True)
class Solution:
    """The least-squares solution for S sets of weights.

    Attributes
    ----------
    parameters, information : (S, P), (S, P, P)
        Changes of the parameters, and the inverse of their covariance.
    log_evidence : (S,)
        Of the data, up to a constant that all sets share.
    """

    parameters: Array
    information: Array
    log_evidence: Array
    _upper: tuple[tuple[Array, Array, Array], ...]

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, (S, P, P)."""
        return np.asarray(np.linalg.inv(self.information))

    def nodes(self) -> Array:
        """Return the changes of the unknowns of every standstill, (S, M, NODE)."""
        out: list[Array] = []
        following = np.zeros((len(self.parameters), NODE))
        for of_next, of_parameters, own in reversed(self._upper):
            x = own - np.einsum("sij,sj->si", of_next, following)
            following = x - np.einsum("sip,sp->si", of_parameters, self.parameters)
            out.append(following)
        return np.stack(out[::-1], axis=1)


@dataclass(frozen=True)
class _Normal:
    """Normal equations for S sets of weights: of the parameters, of nodes, between them, and with those after them."""

    A: Array
    a: Array
    B: Array
    D: Array
    d: Array
    X: Array
    likelihood: Array

    def __add__(self, other: _Normal) -> _Normal:
        return _Normal(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


def solve(
    equations: Sequence[Equations],
    weights: Sequence[Array],
    of_nodes: Array,
    of_parameters: tuple[Array, Array],
) -> Solution:
    """Return the solution.

    Parameters
    ----------
    weights : (S, k, 3) for each kind
        Inverse variances of the rows; (1, k, 3) where all sets have the same.
    of_nodes : (M, NODE, NODE)
        Information about each standstill's unknowns before, about zero change.
    of_parameters : (P, P), (P,)
        Information about the parameters before, and times the change that it expects.
    """
    size = (len(of_nodes), len(of_parameters[1]))
    pairs = list(zip(equations, weights, strict=True))
    whole = _normal([(one, W) for one, W in pairs if len(W) == 1], 1, *size)
    S = max(len(W) for W in weights)
    if S > 1:  # those of rows with the same weights in all sets were needed once
        whole += _normal([(one, W) for one, W in pairs if len(W) == S], S, *size)
    A, a, likelihood = whole.A + of_parameters[0], whole.a + of_parameters[1], whole.likelihood
    upper, left, right = [], [], []
    before, found = np.zeros((1, NODE, NODE)), np.zeros((1, NODE, NODE + size[1] + 1))
    for m in range(size[0]):
        D = whole.D[:, m] + of_nodes[m] - before @ found[..., :NODE]
        own = np.concatenate([whole.X[:, m], whole.B[:, m], whole.d[:, m, :, None]], axis=2)
        own[..., NODE:] -= before @ found[..., NODE:]
        found, before = np.linalg.solve(D, own), np.swapaxes(whole.X[:, m], 1, 2)
        likelihood = likelihood - 0.5 * np.linalg.slogdet(D)[1]
        likelihood = likelihood + 0.5 * np.einsum("sa,sa->s", own[..., -1], found[..., -1])
        upper.append((found[..., :NODE], found[..., NODE:-1], found[..., -1]))
        left.append(own[..., NODE:-1])
        right.append(found[..., NODE:])
    common = np.swapaxes(np.concatenate(left, axis=1), 1, 2) @ np.concatenate(right, axis=1)
    A, a = A - common[..., :-1], a - common[..., -1]
    x = np.linalg.solve(A, a[..., None])[..., 0]
    likelihood = likelihood + 0.5 * np.einsum("sp,sp->s", a, x) - 0.5 * np.linalg.slogdet(A)[1]
    return Solution(x, A, likelihood, tuple(upper))


def _normal(pairs: Sequence[tuple[Equations, Array]], S: int, M: int, P: int) -> _Normal:
    """Return the normal equations of rows with their weights (S, k, 3)."""
    A, a, likelihood = np.zeros((S, P, P)), np.zeros((S, P)), np.zeros(S)
    D, X = np.zeros((2, S, M, NODE, NODE))
    B, d = np.zeros((S, M, NODE, P)), np.zeros((S, M, NODE))
    for one, W in pairs:
        at, J, Jp, r = one.node, one.of_node, one.of_parameters, one.residual
        WJp, WJ, Wr = W[..., None] * Jp, W[..., None] * J, W * r
        rows = WJp.reshape(S, -1, P)
        A += np.swapaxes(rows, 1, 2) @ Jp.reshape(-1, P)
        a -= r.reshape(-1) @ rows
        across = np.swapaxes(J, 1, 2)
        D[:, at] += across @ WJ
        B[:, at] += across @ WJp
        d[:, at] -= (across @ Wr[..., None])[..., 0]
        if one.of_next is not None:
            N = np.swapaxes(one.of_next, 1, 2)
            D[:, at + 1] += N @ (W[..., None] * one.of_next)
            B[:, at + 1] += N @ WJp
            d[:, at + 1] -= (N @ Wr[..., None])[..., 0]
            X[:, at] += np.swapaxes(WJ, 2, 3) @ one.of_next
        likelihood += 0.5 * np.log(W).sum(axis=(1, 2)) - 0.5 * (Wr.reshape(S, -1) @ r.reshape(-1))
    return _Normal(A, a, B, D, d, X, likelihood)

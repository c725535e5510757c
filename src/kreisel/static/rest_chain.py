"""Least squares over a chain: unknowns of every standstill, joined to its neighbours, and parameters common to all.

The chain is eliminated from its beginning to its end, which costs as much as there are standstills. All of it is done
for several sets of weights at once, since the noise figures are found by comparing them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
        Inverse variances of the rows.
    of_nodes : (S, M, NODE, NODE)
        Information about each standstill's unknowns before, about zero change.
    of_parameters : (S, P, P), (S, P)
        Information about the parameters before, and times the change that it expects.
    """
    A, a = (np.array(part, dtype=float) for part in of_parameters)
    D = of_nodes.copy()
    S, M, P = D.shape[0], D.shape[1], A.shape[1]
    X, B, d = np.zeros((S, M, NODE, NODE)), np.zeros((S, M, NODE, P)), np.zeros((S, M, NODE))
    likelihood = np.zeros(S)
    for one, W in zip(equations, weights, strict=True):
        at, J, Jp, r = one.node, one.of_node, one.of_parameters, one.residual
        k, P = Jp.shape[0], Jp.shape[2]
        WJp, WJ, Wr = W[..., None] * Jp, W[..., None] * J, W * r
        rows = WJp.reshape(S, 3 * k, P)
        A += np.swapaxes(rows, 1, 2) @ Jp.reshape(3 * k, P)
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
    upper = []
    for m in range(M):
        right = np.concatenate([X[:, m], B[:, m], d[:, m, :, None]], axis=2)
        found = np.linalg.solve(D[:, m], right)
        likelihood -= 0.5 * np.linalg.slogdet(D[:, m])[1]
        of_next, of_common, own = found[..., :NODE], found[..., NODE:-1], found[..., -1]
        if m + 1 < M:
            onward = np.swapaxes(X[:, m], 1, 2)
            D[:, m + 1] -= onward @ of_next
            B[:, m + 1] -= onward @ of_common
            d[:, m + 1] -= (onward @ own[..., None])[..., 0]
        common = np.swapaxes(B[:, m], 1, 2)
        A -= common @ of_common
        a -= (common @ own[..., None])[..., 0]
        likelihood += 0.5 * np.einsum("sa,sa->s", d[:, m], own)
        upper.append((of_next, of_common, own))
    x = np.linalg.solve(A, a[..., None])[..., 0]
    likelihood += 0.5 * np.einsum("sp,sp->s", a, x) - 0.5 * np.linalg.slogdet(A)[1]
    return Solution(x, A, likelihood, tuple(upper))

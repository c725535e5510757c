"""Least squares over a chain: unknowns of every standstill, joined to its neighbours, and parameters common to all.

The chain is eliminated from its beginning to its end, which costs as much as there are standstills. All of it is done
for several sets of weights at once, since the noise figures are found by comparing them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel._kernels.node_elimination import ChainRows, eliminate
from kreisel.geometry.rotation import Array, Indices

ATTITUDE, GYRO_WALK, ACCEL_WALK = slice(0, 3), slice(3, 6), slice(6, 9)
"""Of the unknowns of a standstill: its attitude (a rotation vector in b), and how far the offsets of gyros and
accelerometers are from their values in the middle of the recording."""


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
    nodes : (S, M, NODE)
        Changes of the unknowns of every standstill.
    """

    parameters: Array
    information: Array
    log_evidence: Array
    nodes: Array

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, (S, P, P)."""
        return np.asarray(np.linalg.inv(self.information))


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
    pairs = sorted(zip(equations, weights, strict=True), key=lambda pair: len(pair[1]))
    S = len(pairs[-1][1])
    alike = sum(len(one.node) for one, W in pairs if len(W) < S)
    kinds = [one for one, _ in pairs]
    rows = ChainRows(
        np.concatenate([one.residual for one in kinds]),
        np.concatenate([one.node for one in kinds]),
        np.concatenate([np.full_like(one.node, -1) if one.of_next is None else one.node + 1 for one in kinds]),
        np.concatenate([one.of_node for one in kinds]),
        np.concatenate([np.zeros_like(one.of_node) if one.of_next is None else one.of_next for one in kinds]),
        np.concatenate([one.of_parameters for one in kinds]),
    )
    W = np.concatenate([np.broadcast_to(own, (S, *own.shape[1:])) for _, own in pairs], axis=1)
    return Solution(*eliminate(rows, W, alike, of_nodes, np.column_stack(of_parameters)))

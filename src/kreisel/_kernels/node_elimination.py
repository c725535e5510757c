"""Least squares over a chain of nodes, eliminated from its beginning to its end, for several sets of weights."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np

from kreisel._kernels.compiled import check_count, function
from kreisel._kernels.views import (
    Array,
    Indices,
    NumbersView,
    Pointer,
    Stack,
    StackView,
    Table,
    TableView,
    check_indices,
    check_lengths,
)

NODE = 9
"""Unknowns of a node."""

check_count("node", NODE)


class ChainRows(NamedTuple):
    """Rows, three of each of t: residual + of_node x_node + of_next x_next + of_parameters p = noise.

    residual (t, 3); node, next (t,), -1 for no next one; of_node, of_next (t, 3, NODE); of_parameters (t, 3, P).
    """

    residual: Table
    node: Indices
    next: Indices
    of_node: Stack
    of_next: Stack
    of_parameters: Stack


_eliminate = function(
    "eliminate", Pointer(ChainRows), StackView, ctypes.c_int64, *[TableView] * 3, StackView, NumbersView, StackView
)


def eliminate(
    rows: ChainRows, weights: Array, alike: int, of_nodes: Array, of_parameters: Array
) -> tuple[Array, Array, Array, Array]:
    """Return changes of parameters (S, P), information (S, P, P), log-evidences (S,), changes of nodes (S, M, NODE).

    A log-evidence is -inf for sets of weights whose equations are not positive definite; nothing is changed for them.

    Parameters
    ----------
    weights : (S, t, 3)
        Inverse variances of the rows.
    alike
        Number of rows, the first ones, that have the weights of the first set in all sets.
    of_nodes : (M, NODE, NODE)
        Information about each node before, about zero.
    of_parameters : (P, P + 1)
        Information about the parameters before, and times what it expects as a last column.
    """
    t, M, P, S = len(rows.node), len(of_nodes), len(of_parameters), len(weights)
    check_lengths(
        residual=(rows.residual, (t, 3)), next=(rows.next, (t,)), of_node=(rows.of_node, (t, 3, NODE)),
        of_next=(rows.of_next, (t, 3, NODE)), of_parameters=(rows.of_parameters, (t, 3, P)),
        weights=(weights, (S, t, 3)), of_nodes=(of_nodes, (M, NODE, NODE)), information=(of_parameters, (P, P + 1)),
    )  # fmt: skip
    check_indices("node", rows.node, 0, M)
    joined = rows.next >= 0
    if not np.array_equal(rows.next[joined], rows.node[joined] + 1):
        raise ValueError("rows that join other nodes than neighbours")
    check_indices("next", rows.next, -1, M)
    if not 0 <= alike <= t or not S:
        raise ValueError(f"{alike} rows alike of {t}, in {S} sets")
    parameters, information = np.zeros((S, P)), np.zeros((S, P, P))
    evidence, nodes = np.empty(S), np.zeros((S, M, NODE))
    _eliminate(
        rows, weights, alike, of_nodes.reshape(-1, NODE), of_parameters, parameters, information, evidence, nodes
    )
    return parameters, information, evidence, nodes

"""What many small changes of a filter's state do over recorded updates, and the adjoint of that."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np

from kreisel._kernels.compiled import function
from kreisel._kernels.views import (
    Array,
    Indices,
    IndicesView,
    StackView,
    TableView,
    check_indices,
    check_lengths,
)

_SLOPES = (StackView, StackView, StackView, TableView)
_carry_terms = function(
    "carry_terms", *_SLOPES, TableView, TableView, IndicesView, IndicesView, IndicesView, IndicesView, StackView,
    StackView, StackView, ctypes.c_int64, TableView, StackView,
)  # fmt: skip
_carry_innovations = function("carry_innovations", *_SLOPES, StackView, TableView)
_carry_back = function(
    "carry_back", *_SLOPES, StackView, IndicesView, StackView, IndicesView, StackView, TableView
)  # fmt: skip


class SlopeTables(NamedTuple):
    """What a small change of the state does over u updates.

    transition (u, c, n) to the last c degrees of freedom, which move; design (u, q, n) to the whitened prediction; gain
    (u, q, n), transposed, is what the whitened innovation adds to the state; keep (u, n): the part of each degree of
    freedom that is kept from the update before.
    """

    transition: Array
    design: Array
    gain: Array
    keep: Array

    def check(self) -> tuple[int, int, int]:
        """Return the numbers of updates, of the prediction's numbers and of degrees of freedom.

        Raises
        ------
        ValueError
            If the tables do not fit together.
        """
        u, n = self.keep.shape
        c, q = self.transition.shape[1], self.design.shape[1]
        check_lengths(
            transition=(self.transition, (u, min(c, n), n)),
            design=(self.design, (u, q, n)),
            gain=(self.gain, (u, q, n)),
        )
        return u, q, n


class SlopeTerms(NamedTuple):
    """Terms of readings and poses over u updates.

    functions (u, f), and their double integrals moments (u, f), or (0, f) for none. Of each of m terms: `function`,
    which it has; `place`, the degree of freedom that it adds to as long as an update lasts; `direction` of poses;
    `axis` of accelerometers; -1 for none. A unit of a direction changes the whitened prediction by `seen` (u, q, d), a
    unit of an axis the position, which begins at `position`, by `axes` (u, 3, 3), and the prediction by `axes_seen`
    (u, q, 3).
    """

    functions: Array
    moments: Array
    function: Indices
    place: Indices
    direction: Indices
    axis: Indices
    seen: Array
    axes: Array
    axes_seen: Array
    position: int

    def check(self, u: int, q: int, n: int) -> None:
        """Raise a ValueError if the terms do not fit together, or not to slopes of these sizes."""
        f, d, m = self.functions.shape[1], self.seen.shape[2], self.function.size
        integrated = u if len(self.moments) else 0
        check_lengths(
            functions=(self.functions, (u, f)), moments=(self.moments, (integrated, f)), place=(self.place, (m,)),
            direction=(self.direction, (m,)), axis=(self.axis, (m,)), seen=(self.seen, (u, q, d)),
        )  # fmt: skip
        if integrated:
            check_lengths(axes=(self.axes, (u, 3, 3)), axes_seen=(self.axes_seen, (u, q, 3)))
        if not 0 <= self.position <= n - 3:
            raise ValueError(f"a position from {self.position} on in {n} degrees of freedom")
        check_indices("function", self.function, 0, f)
        check_indices("place", self.place, -1, n)
        check_indices("direction", self.direction, -1, d)
        check_indices("axis", self.axis, -1, 3)


def carry_terms(slopes: SlopeTables, terms: SlopeTerms, state: Array) -> Array:
    """Carry derivatives (n, m) of the state by m terms over u updates, in place; return the predictions' (u, q, m)."""
    u, q, n = slopes.check()
    terms.check(u, q, n)
    check_lengths(state=(state, (n, terms.function.size)))
    predictions = np.empty((u, q, state.shape[1]))
    _carry_terms(*slopes, *terms, state, predictions)
    return predictions


def carry_innovations(slopes: SlopeTables, innovations: Array, state: Array) -> None:
    """Carry what whitened innovations (u, q, m) make of the state, (n, m), over u updates, in place."""
    u, q, n = slopes.check()
    check_lengths(innovations=(innovations, (u, q, state.shape[1])), state=(state, (n, state.shape[1])))
    _carry_innovations(*slopes, innovations, state)


def carry_back(
    slopes: SlopeTables, weights: Array, state: Array, *, after: Indices, before: Indices
) -> tuple[Array, Array]:
    """Carry derivatives (n, m) of m quantities by the state back over u updates, in place.

    Parameters
    ----------
    weights : (u, q, m)
        Their derivatives by whitened innovations alone; made those by whitened predictions, with all that follows.
    after, before
        Degrees of freedom of which the derivatives after and before each update are returned, (u, r, m).
    """
    u, q, n = slopes.check()
    m = state.shape[1]
    check_lengths(weights=(weights, (u, q, m)), state=(state, (n, m)))
    check_indices("after", after, 0, n)
    check_indices("before", before, 0, n)
    ends, begins = np.empty((u, after.size, m)), np.empty((u, before.size, m))
    _carry_back(*slopes, weights, after, ends, before, begins, state)
    return ends, begins

"""Quaternions, scalar first, one in each column of a (4, m) array."""

from __future__ import annotations

from kreisel._kernels.views import Array, NumbersView, TableView, for_columns, padded

from .compiled_parts import function

_turn = function("turn", TableView, TableView)
_turn_between = function("turn_between", NumbersView, TableView, TableView)


def plus(q: Array, theta: Array) -> Array:
    """Return q exp(theta) for columns: q (4, m), theta (3, m), angles of any size."""
    out = padded(q)
    _turn(out, padded(theta))
    return out[:, : q.shape[1]]


def minus(q: Array, origin: Array) -> Array:
    """Return log(origin^-1 q) for columns, (3, m), at most pi long: q (4, m), origin (4,)."""
    out = for_columns(3, q.shape[1])
    _turn_between(origin, padded(q), out)
    return out[:, : q.shape[1]]

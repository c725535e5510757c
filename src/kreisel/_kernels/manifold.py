"""Small changes of a state made of vectors and rotations, and the way back."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compiled import function
from kreisel._kernels.views import Array, IndexTableView, Indices, NumbersView, TableView, for_columns, padded

_plus = function("plus", IndexTableView, NumbersView, TableView, TableView)
_minus = function("minus", IndexTableView, TableView, NumbersView, TableView)


def plus(parts: Indices, x: Array, change: Array) -> Array:
    """Return the states (size, m) that lie changes (degrees, m) away from the state x (size,).

    parts (p, 4): first degree of freedom, how many, first stored number, whether a rotation; one part after another.
    Rotations are stored as quaternions and changed on their right.
    """
    m = change.shape[1]
    out = for_columns(x.size, m)
    if m:
        _plus(parts, np.ascontiguousarray(x), padded(change), out)
    return out[:, :m]


def minus(parts: Indices, states: Array, x: Array, degrees: int) -> Array:
    """Return the changes (degrees, m) that lead from the state x (size,) to states (size, m); parts as for `plus`."""
    m = states.shape[1]
    out = for_columns(degrees, m)
    if m:
        _minus(parts, padded(states), np.ascontiguousarray(x), out)
    return out[:, :m]

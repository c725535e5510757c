"""Preintegrated motion onto the navigation state."""

from __future__ import annotations

import ctypes

from kreisel._kernels.views import Array, TableView, padded

from .compiled_parts import function
from .preintegration import Increments

_compose = function("compose", ctypes.c_double, *[TableView] * 8)


def compose(
    duration: float, motion: Increments, gravity: Array, earth_rate: Array, q: Array, v: Array, p: Array
) -> tuple[Array, Array, Array]:
    """Return attitude (4, m), velocity and position (3, m) after an interval of s: equation (9).

    gravity and earth_rate (3, m), in r; the motion has as many columns.
    """
    m = q.shape[1]
    q, v, p = padded(q), padded(v), padded(p)
    around = padded(gravity), padded(earth_rate)
    _compose(duration, padded(motion.dq), padded(motion.dv), padded(motion.dp), *around, q, v, p)
    return q[:, :m], v[:, :m], p[:, :m]

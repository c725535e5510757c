"""One plain strapdown pass over readings: the unit in which run times are quoted."""

from __future__ import annotations

import ctypes
import time

import numpy as np

from kreisel._kernels.compiled import function
from kreisel._kernels.views import Array, NumbersView, TableView, check_lengths

_strapdown_pass = function(
    "strapdown_pass", TableView, TableView, TableView, NumbersView, TableView, NumbersView, NumbersView,
    ctypes.c_double, NumbersView,
)  # fmt: skip


def strapdown_seconds(rates: Array, forces: Array, interval: float, repeats: int = 9) -> float:
    """Return the shortest time of one pass over readings (n, 3) among a few, s.

    A pass is what any strapdown navigation must do: sensor correction, attitude with the coning term, velocity and
    position, sample by sample.
    """
    rates, forces = np.ascontiguousarray(rates), np.ascontiguousarray(forces)
    gravity, times = np.array([0.0, 0.0, -9.81]), []
    for _ in range(repeats):
        began = time.perf_counter()
        navigated(rates, forces, interval, gravity)
        times.append(time.perf_counter() - began)
    return min(times)


def navigated(rates: Array, forces: Array, interval: float, gravity: Array) -> float:
    """Return the sum of position and of the attitude's first component after a pass over readings (n, 3) from rest."""
    n, eye, zero, out = len(rates), np.eye(3), np.zeros(3), np.zeros(1)
    check_lengths(rates=(rates, (n, 3)), forces=(forces, (n, 3)), gravity=(gravity, (3,)))
    _strapdown_pass(rates, forces, eye, zero, eye, zero, gravity, interval, out)
    return float(out[0])

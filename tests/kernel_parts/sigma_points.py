"""A step of the sigma-point Kalman filter by itself: drawing points, and predicting and updating with them."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np

from kreisel._kernels.filter_arguments import Gaussian
from kreisel._kernels.views import (
    Array,
    IndexTableView,
    Indices,
    Numbers,
    NumbersView,
    Pointer,
    Table,
    TableView,
    for_columns,
    padded,
)

from .compiled_parts import function


class UpdateArrays(NamedTuple):
    """What an update is given and gives: see `update`."""

    mean: Numbers
    upper: Table
    points: Table
    noise: Table
    seen: Table
    prediction_noise: Table
    innovation: Numbers
    factor: Table
    nis: Numbers
    innovation_factor: Table
    whitened: Numbers
    gain: Table


_sample = function(
    "sample", IndexTableView, ctypes.c_int64, ctypes.c_int64, NumbersView, TableView, ctypes.c_double, TableView
)
_update = function(
    "update", IndexTableView, IndexTableView, ctypes.c_int64, ctypes.c_int64, NumbersView, Pointer(UpdateArrays),
    ctypes.c_double,
)  # fmt: skip


def sample(parts: Indices, belief: Gaussian, spread: float, gyro: int = 0, sensors: int = 0) -> Array:
    """Return the sigma points (size, 2 n + 1): equation (17).

    The centre stands first; then those of the first `gyro` degrees of freedom, in plus and then in minus direction,
    those of the degrees up to `sensors`, and those of all others.
    """
    points = for_columns(belief.mean.size, 2 * len(belief.upper) + 1)
    _sample(parts, gyro, sensors, belief.mean, belief.upper, spread, points)
    return points[:, : 2 * len(belief.upper) + 1]


class Updated(NamedTuple):
    """What an update did: whether the measurement was used, its normalised innovation squared, and its innovation.

    Attributes
    ----------
    factor, whitened : (m, m), (m,)
        Factor of the innovation's covariance, and the innovation divided by it.
    gain : (n, m)
        On what is so divided.
    """

    used: bool
    nis: float
    factor: Array
    whitened: Array
    gain: Array


def update(
    parts: Indices, tail: Indices, weights: Array, belief: Gaussian, points: Array, noise: Array, seen: Array,
    prediction_noise: Array, innovation: Array, factor: Array, gate: float,
) -> Updated:  # fmt: skip
    """Predict and update: change the belief in place by a measurement that sigma points predict: equations (18)-(20).

    Parameters
    ----------
    parts, tail : (p, 4), (t, 4)
        Tables of the state and of its last parts, which have moved.
    weights : (5,)
        See `WEIGHTS`.
    points, noise : (size, 2 n + 1), (c, k)
        At the update, in the order of `sample`; columns of noise of the degrees of freedom that have moved.
    seen, prediction_noise : (m, 2 n + 1), (m, 2 k)
        Predicted measurements as distances from the centre's: of the sigma points, and of the centre with noise
        put in, plus and minus.
    innovation, factor : (m,), (m, e)
        The measurement's distance from the centre's prediction; factor of its noise.
    gate
        Bound of the normalised innovation squared, beyond which only the prediction is taken over.
    """
    m, n = len(seen), len(belief.upper)
    out = np.zeros(1), np.zeros((m, m)), np.zeros(m), for_columns(m, n)
    of = UpdateArrays(
        *belief, padded(points), noise, padded(seen), padded(prediction_noise), innovation.copy(), factor, *out
    )
    _update(parts, tail, 0, 0, weights, of, gate)
    nis, innovation_factor, whitened, gain = out
    return Updated(bool(nis[0] <= gate), float(nis[0]), innovation_factor, whitened, gain[:, :n].T)

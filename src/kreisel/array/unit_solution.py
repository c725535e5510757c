"""Least squares of the rows of a unit's six axes, and deviations that follow what is left of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.errors import EstimationError
from kreisel.estimation.robust import normal_scale
from kreisel.geometry.rotation import Array, Indices, Mask

_GROSS = 6.0
"""Standard deviations beyond which a row is left out. Chosen: none of a million rows of noise is."""

LENGTHS = (1.0, 4.0, 16.0)
"""Seconds of the parts whose scatter shows what the model of the noise leaves out; the longest tenfold in ten minutes.
Chosen: periods of an arm's moves, and a few of them."""

_FEW = 12
"""Parts below which a scatter is not known well enough. Chosen: its deviation is then a fifth."""


_CELL, _OWN = 0.25, 4
"""Share of a step of rounding over which its error changes little, and parameters of an axis that attitudes at rest
show. Chosen: a quarter of what the error ranges over."""


@dataclass(frozen=True)
class Axis:
    """Rows of one axis: derivatives (n, c) by some of all parameters, their places (c,), and what is left (n,)."""

    columns: Array
    places: Indices
    left: Array


@dataclass(frozen=True)
class Solved:
    """A step of the fit: averaged rows with their weights, scatter without and with far ones, change, information."""

    axes: list[Axis]
    weights: Array
    noise: Array
    rough: Array
    change: Array
    information: Array


def solve(axes: list[Axis], whole: Mask, count: int) -> Solved:
    """Return the least squares solution; rows far off are left out, and counted by the scatter of the others."""
    noise, rough, change, weights = np.ones(6), np.ones(6), np.zeros(count), np.tile(whole.astype(float), (6, 1))
    for step in range(3):
        A, b = np.zeros((count, count)), np.zeros(count)
        for k, axis in enumerate(axes):
            w = weights[k] / noise[k] ** 2
            X = axis.columns * w[:, None]
            A[np.ix_(axis.places, axis.places)] += X.T @ axis.columns
            b[axis.places] += X.T @ axis.left
        change = _solution(A, b)
        for k, axis in enumerate(axes):
            left = axis.left - axis.columns @ change[axis.places]
            used = left[whole]
            noise[k] = normal_scale(used) + 1e-15
            near = np.abs(left) < _GROSS * noise[k]
            if step:
                weights[k] = whole & near
            noise[k], rough[k] = (
                max(float(np.sqrt(np.mean(left[rows] ** 2))), 1e-15) for rows in (whole & near, whole)
            )
    return Solved(axes, weights / noise[:, None] ** 2, noise, rough, change, A)


def _solution(A: Array, b: Array) -> Array:
    """Return x with A x = b, by columns of unit size.

    Raises
    ------
    EstimationError
        If a direction is not determined.
    """
    size = np.sqrt(np.diag(A))
    if not (size > 0.0).all():
        raise EstimationError("its readings, or the motion, do not determine its parameters: an axis does not change")
    scaled = A / size[:, None] / size
    if float(np.linalg.eigvalsh(scaled)[0]) < 1e-12:
        raise EstimationError("the motion does not determine its parameters: turn about all axes")
    return np.asarray(np.linalg.solve(scaled, b / size) / size)


def parted(values: Array, length: int) -> Array:
    """Return sums (parts, …) of rows over parts; a last one that is not whole is left out."""
    n = len(values) // length
    return np.asarray(values[: n * length].reshape(n, length, *values.shape[1:]).sum(axis=1))


def _scores(solved: Solved) -> Array:
    """Return what each row says of all parameters at the solution, (n, p)."""
    out = np.zeros((solved.axes[0].left.size, solved.change.size))
    for k, axis in enumerate(solved.axes):
        left = axis.left - axis.columns @ solved.change[axis.places]
        out[:, axis.places] += axis.columns * (solved.weights[k] * left)[:, None]
    return out


def excess(solved: Solved, row: float, used: Indices | None = None) -> Array:
    """Return factors on the deviations by which they follow the scatter of parts of several lengths, (p,).

    used: places of the parameters that were estimated; all by default.
    """
    some = np.arange(solved.change.size) if used is None else used
    inverse = np.linalg.inv(solved.information[np.ix_(some, some)])
    usual, scores = np.sqrt(np.diag(inverse)), _scores(solved)[:, some]
    factor = np.ones(usual.size)
    for length in LENGTHS:
        parts = parted(scores, max(1, round(length / row)))
        if len(parts) < _FEW:
            break
        influence = parts @ inverse
        seen = np.sqrt(np.sum(influence**2, axis=0) * len(parts) / (len(parts) - 1.0))
        factor = np.maximum(factor, seen / usual)
    return factor


def excess_by_rounding(solved: Solved, raw: Array, step: float) -> Array:
    """Return factors on the deviations by which they follow accelerometers rounded to steps, (p,).

    The error of rounding is a function of the reading: rows (n, 6) with the same one err by the same, whenever they
    are taken.
    """
    if not step:
        return np.ones(solved.change.size)
    inverse, seen = np.linalg.inv(solved.information), np.zeros(solved.change.size)
    for k, axis in enumerate(solved.axes[3:], start=3):
        left = axis.left - axis.columns @ solved.change[axis.places]
        _, cell = np.unique(np.round(raw[:, k] / (_CELL * step)), return_inverse=True)
        sums = np.zeros((int(cell.max()) + 1, axis.places.size))
        np.add.at(sums, cell, axis.columns * (solved.weights[k] * left)[:, None])
        weights = np.bincount(cell, solved.weights[k])
        count = float(weights.sum() ** 2 / np.sum(weights**2))
        lost = count / max(count - _OWN, 1.0)  # to the parameters that are fitted to them
        seen += lost * np.sum((sums @ inverse[axis.places]) ** 2, axis=0)
    return np.maximum(np.sqrt(seen / np.diag(inverse)), 1.0)


def products_over(left: Array, right: Array, length: int) -> Array:
    """Return left' right summed over parts, (parts, a, b)."""
    n = len(left) // length
    a, b = (part[: n * length].reshape(n, length, -1) for part in (left, right))
    return np.asarray(np.swapaxes(a, 1, 2) @ b)

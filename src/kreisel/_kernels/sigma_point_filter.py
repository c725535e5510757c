"""A step of the sigma-point Kalman filter: drawing points, putting them together again, using a measurement.

Nothing here knows what is filtered: the models of the cell stand in `process_model` and `measurement_model`. Factors
are kept transposed, because their rows are then the columns that are rotated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kreisel._kernels import manifold, triangular
from kreisel._kernels.arrays import Array, Indices
from kreisel._kernels.blocks import column_of, forward, place
from kreisel._kernels.compilation import kernel, part_of_kernel

SPREAD, MEAN, SECOND, SHIFT, CENTRE = range(5)
"""Places of the figures of `estimation.sigma_points.SigmaWeights`."""

ROUNDING = 1e-9
"""Share of a deviation whose square is lost beside it in rounding."""


class Gaussian(NamedTuple):
    """Mean (size,) as stored, and factor (n, n) of the covariance, transposed: upper triangular."""

    mean: Array
    upper: Array


class Predicted(NamedTuple):
    """Sigma points carried to an update, and the measurements they predict.

    Attributes
    ----------
    points : (size, 2 n + 1)
        At the update.
    noise : (c, k)
        Columns of noise of the degrees of freedom that have moved.
    measured, measured_noise : (m, 2 n + 1), (m, 2 k)
        Predicted measurements as distances from the centre's: of the sigma points, and of the centre with noise
        put in, plus and minus.
    """

    points: Array
    noise: Array
    measured: Array
    measured_noise: Array


class Updated(NamedTuple):
    """What an update did: whether it was used, and its innovation.

    Attributes
    ----------
    used, nis
        Whether the measurement was used; its normalised innovation squared.
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


@kernel
def draw(parts: Indices, mean: Array, upper: Array, spread: float, points: Array) -> None:
    """Write the sigma points (size, 2 n + 1), equation (17): centre, then all in plus, then all in minus direction.

    parts (p, 4): see `manifold.DEGREE`; mean (size,) and upper (n, n): see `Gaussian`.
    """
    n = upper.shape[0]
    change = np.zeros((n, 2 * n + 1))
    for i in range(n):
        for j in range(i + 1):
            d = spread * upper[j, i]
            change[i, 1 + j] = d
            change[i, 1 + n + j] = -d
    manifold.plus(parts, mean, change, points)


@part_of_kernel
def unscented_moments(distance: Array, w: Array, first: Array, further: Array, shift: Array) -> int:
    """Write mean and columns of the covariance from distances of sigma points: equation (18).

    Parameters
    ----------
    distance : (r, 2 n + 1)
    w : (5,)
        See `SPREAD`.
    first : (r, n)
    further : (at least n + 2, r)
        Further columns, as rows.
    shift : (r,)

    Returns
    -------
    int
        How many rows of `further` were written: only those whose squares are not lost in rounding.
    """
    r, n = first.shape
    least = np.empty(r)
    for i in range(r):
        total = 0.0
        square = 0.0
        for j in range(n):
            plus, minus = distance[i, 1 + j], distance[i, forward(1 + n + j)]
            first[i, j] = (plus - minus) / (2.0 * w[SPREAD])
            total += plus + minus
            square += first[i, j] * first[i, j]
        shift[i] = w[MEAN] * total
        least[i] = ROUNDING * math.sqrt(square)
    rows = 0
    for j in range(n if w[SECOND] > 0.0 else 0):
        counts = False
        for i in range(r):
            both = distance[i, 1 + j] + distance[i, 1 + n + j]
            further[rows, i] = w[SECOND] * (both - 2.0 * w[SHIFT] * shift[i])
            counts = counts or abs(further[rows, i]) > least[i]
        rows += 1 if counts else 0
    if w[CENTRE] > 0.0:
        for i in range(r):
            further[rows, i] = w[CENTRE] * shift[i]
        rows += 1
    for i in range(r):
        further[rows, i] = 0.0
    return rows


@part_of_kernel
def deviations(upper: Array, i: int, out: Array) -> None:
    """Write the standard deviations of the first k degrees of freedom into row i of out (u, k), from upper (n, n)."""
    for j in range(out.shape[1]):
        out[i, j] = 0.0
    for r in range(out.shape[1]):
        for j in range(forward(r), forward(out.shape[1])):
            out[i, j] += upper[r, j] * upper[r, j]
    for j in range(out.shape[1]):
        out[i, j] = math.sqrt(out[i, j])


@part_of_kernel
def correct(parts: Indices, mean: Array, gain: Array, whitened: Array) -> None:
    """Change a mean (size,) of parts (p, 4) in place by gain (n, m) times whitened (m,)."""
    n, m = gain.shape
    change = np.zeros((n, 1))
    for i in range(n):
        for j in range(m):
            change[i, 0] += gain[i, j] * whitened[j]
    out = np.empty((mean.size, 1))
    manifold.plus(parts, mean, change, out)
    for i in range(mean.size):
        mean[i] = out[i, 0]


@kernel
def update(
    parts: Indices,
    tail: Indices,
    w: Array,
    belief: Gaussian,
    predicted: Predicted,
    innovation: Array,
    measurement_factor: Array,
    gate: float,
) -> Updated:
    """Predict and update: change the belief in place by a measurement that sigma points predict.

    Parameters
    ----------
    parts, tail, w : (p, 4), (t, 4), (5,)
        Tables of the state and of its last parts, which have moved; weights of the sigma points.
    belief, predicted
        The belief before the step, the one after it on return; what became of its sigma points.
    innovation : (m,)
        The measurement's distance from the centre's prediction; from the mean prediction on return.
    measurement_factor : (m, e)
        Factor of the measurement's noise.
    gate
        Bound of the normalised innovation squared, beyond which only the prediction is taken over: equation (20).
    """
    mean, upper, points, noise = belief.mean, belief.upper, predicted.points, predicted.noise
    seen, seen_noise = predicted.measured, predicted.measured_noise
    n, m, e = upper.shape[0], seen.shape[0], measurement_factor.shape[1]
    c, k = noise.shape
    last = tail.shape[0] - 1
    moving = tail[last, manifold.STORED] + (4 if tail[last, manifold.ROTATION] else tail[last, manifold.DEGREES])
    at = mean.size - moving
    centre = column_of(points, 0)
    distance = np.empty((m + c, 2 * n + 1))
    place(seen, 0, 0, distance)
    manifold.minus(tail, points[at:], centre[at:], distance[m:])
    first = np.empty((m + c, n))
    further = np.zeros((n + 2 + k + e, m + c))
    shift = np.empty(m + c)
    rows = unscented_moments(distance, w, first, further, shift)
    for j in range(k):
        for r in range(m):
            further[rows + j, r] = 0.5 * (seen_noise[r, j] - seen_noise[r, k + j])
        for r in range(c):
            further[rows + j, m + r] = noise[r, j]
    for j in range(e):
        for r in range(m):
            further[rows + k + j, r] = measurement_factor[r, j]
    for r in range(m):
        innovation[r] -= shift[r]
    moved, change = np.empty((moving, 1)), np.empty((c, 1))
    for r in range(c):
        change[r, 0] = shift[m + r]
    manifold.plus(tail, centre[at:], change, moved)
    for r in range(mean.size):
        mean[r] = centre[r] if r < at else moved[r - at, 0]
    innovation_factor, whitened = np.empty((m, m)), np.empty(m)
    gain = np.empty((n, m))
    before = upper.copy()
    # equation (19)
    triangular.condition(first, upper, further[: rows + k + e], innovation, innovation_factor, whitened, gain, upper)
    nis = 0.0
    for r in range(m):
        nis += whitened[r] * whitened[r]
    used = nis <= gate
    if used:
        correct(parts, mean, gain, whitened)
    else:
        nothing = np.empty((0, 0))
        triangular.condition(
            first[m:].copy(), before, further[: rows + k, m:].copy(), whitened[:0], nothing, whitened[:0],
            np.empty((n, 0)), upper,
        )  # fmt: skip
    return Updated(used, nis, innovation_factor, whitened, gain)

"""Orthogonal triangularisation of covariance factors, for states of which few change between updates."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels.arrays import Array
from kreisel._kernels.blocks import forward, place
from kreisel._kernels.compilation import kernel, reassociating_kernel


@kernel
def triangularise(rows: Array) -> None:
    """Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows.

    Householder's reflections; the diagonal comes out positive.
    """
    r = rows.shape[1]
    columns = np.empty((r, rows.shape[0]))
    for i in range(r):
        for j in range(rows.shape[0]):
            columns[i, j] = rows[j, i]
    reflect(columns)
    rows[:] = 0.0
    for i in range(r):
        sign = -1.0 if columns[i, i] < 0.0 else 1.0
        for j in range(i, r):
            rows[i, j] = sign * columns[j, i]


@reassociating_kernel
def reflect(columns: Array) -> None:
    """Make a matrix upper triangular, given by its columns (r, k), k >= r; below the diagonal it is not made zero."""
    r, k = columns.shape
    for i in range(r):
        below = 0.0
        for a in range(forward(i + 1), forward(k)):
            below += columns[i, a] * columns[i, a]
        if below == 0.0:
            continue
        pivot = columns[i, i]
        length = math.sqrt(pivot * pivot + below)
        # reflected to the far side, so that nothing cancels
        head = pivot + (length if pivot >= 0.0 else -length)
        scale = 2.0 / (head * head + below)
        for j in range(i + 1, r):
            dot = head * columns[j, i]
            for a in range(forward(i + 1), forward(k)):
                dot += columns[i, a] * columns[j, a]
            dot *= scale
            columns[j, i] -= dot * head
            for a in range(forward(i + 1), forward(k)):
                columns[j, a] -= dot * columns[i, a]
        columns[i, i] = -length if pivot >= 0.0 else length


@kernel
def condition(
    first: Array,
    upper: Array,
    further: Array,
    innovation: Array,
    innovation_factor: Array,
    whitened: Array,
    gain: Array,
    posterior: Array,
) -> None:
    """Write what a measurement leaves of a covariance after its last degrees of freedom moved: equation (19).

    The array of columns

        [ seen  | seen_further  ]
        [ held  |      0        ]
        [ moved | moved_further ]

    has the joint covariance of measurement and state as its outer product. It is made lower triangular by
    rotations of its columns; `held` is so already, and stays so all the way.

    Parameters
    ----------
    first : (m + c, n)
        Columns of the m measurements and of the c last degrees of freedom, one for each of the state's.
    upper : (n, n)
        Lower triangular factor before the step, transposed; its first n - c rows, untransposed, are `held`.
    further : (k, m + c)
        Further columns, as rows: noise, curvature, and the measurement's own noise.
    innovation : (m,)
    innovation_factor, whitened, gain, posterior : (m, m), (m,), (n, m), (n, n)
        Factor of the innovation's covariance, the innovation divided by it, cross-covariance times its
        inverse transpose, and factor of the state's covariance once measured, transposed like `upper`, which it
        may be itself. With m = 0 the last is the predicted one.
    """
    m = innovation_factor.shape[0]
    n = upper.shape[0]
    changing = first.shape[0] - m
    held = n - changing
    # What does not touch the held degrees of freedom is small, and triangularised alone.
    small = np.zeros((max(changing + further.shape[0], m + changing), m + changing))
    for i in range(changing):
        for r in range(m + changing):
            small[i, r] = first[r, held + i]
    place(further, changing, 0, small)
    triangularise(small)
    head = np.zeros((m, m))
    pivot = np.zeros((m, n))
    for i in range(m):
        for r in range(i, m):
            head[i, r] = small[i, r]
        for r in range(changing):
            pivot[i, held + r] = small[i, m + r]
    for j in range(changing):
        for r in range(j, changing):
            posterior[held + j, held + r] = small[m + j, m + r]
    # Each column is rotated into the measurements' pivots, from the last to the first: a pivot then holds
    # nothing above the row where the column begins.
    column = np.empty(n)
    seen = np.empty(m)
    for j in range(held - 1, -1, -1):
        for r in range(m):
            seen[r] = first[r, j]
        for r in range(forward(j), forward(held)):
            column[r] = upper[j, r]
        for r in range(changing):
            column[held + r] = first[m + r, j]
        for i in range(m):
            if seen[i] == 0.0:
                continue
            length = math.sqrt(head[i, i] * head[i, i] + seen[i] * seen[i])
            c = head[i, i] / length
            s = seen[i] / length
            head[i, i] = length
            for r in range(i + 1, m):
                x = head[i, r]
                head[i, r] = c * x + s * seen[r]
                seen[r] = c * seen[r] - s * x
            for r in range(forward(j), forward(n)):
                x = pivot[i, r]
                pivot[i, r] = c * x + s * column[r]
                column[r] = c * column[r] - s * x
        for r in range(forward(j), forward(n)):
            posterior[j, r] = column[r]
    for i in range(m):
        for r in range(m):
            innovation_factor[r, i] = head[i, r]
        for r in range(n):
            gain[r, i] = pivot[i, r]
    for i in range(m):
        left = innovation[i]
        for r in range(i):
            left -= innovation_factor[i, r] * whitened[r]
        whitened[i] = left / innovation_factor[i, i]


@kernel
def inflate(upper: Array, index: int, deviation: float) -> None:
    """Add the square of a deviation to the variance of one degree of freedom, in place.

    upper (n, n): a lower triangular factor, transposed. A row with one entry is rotated into it from the left; only
    the rows from `index` on change.
    """
    n = upper.shape[0]
    extra = np.zeros(n)
    extra[index] = deviation
    for j in range(index, n):
        length = math.sqrt(upper[j, j] * upper[j, j] + extra[j] * extra[j])
        c = upper[j, j] / length
        s = extra[j] / length
        for i in range(forward(j), forward(n)):
            x = upper[j, i]
            upper[j, i] = c * x + s * extra[i]
            extra[i] = c * extra[i] - s * x

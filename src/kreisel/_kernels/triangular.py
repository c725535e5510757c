"""Orthogonal triangularisation of covariance factors, for states of which few change between updates."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels.compilation import kernel


@kernel
def triangularise(rows):
    """Replace rows (k, r), k >= r, by an upper triangular matrix above zeros, with the same rows^T rows.

    Householder's reflections; the diagonal comes out positive.
    """
    k, r = rows.shape
    dots = np.empty(r)
    for i in range(r):
        below = 0.0
        for a in range(i + 1, k):
            below += rows[a, i] * rows[a, i]
        if below > 0.0:
            length = math.sqrt(rows[i, i] * rows[i, i] + below)
            # reflected to the far side, so that nothing cancels
            head = rows[i, i] + (length if rows[i, i] >= 0.0 else -length)
            scale = 2.0 / (head * head + below)
            for j in range(i + 1, r):
                dots[j] = head * rows[i, j]
            for a in range(i + 1, k):
                c = rows[a, i]
                if c != 0.0:
                    for j in range(i + 1, r):
                        dots[j] += c * rows[a, j]
            for j in range(i + 1, r):
                rows[i, j] -= scale * head * dots[j]
            for a in range(i + 1, k):
                c = scale * rows[a, i]
                if c != 0.0:
                    for j in range(i + 1, r):
                        rows[a, j] -= c * dots[j]
            rows[i, i] = -length if rows[i, i] >= 0.0 else length
            for a in range(i + 1, k):
                rows[a, i] = 0.0
        if rows[i, i] < 0.0:
            for j in range(i, r):
                rows[i, j] = -rows[i, j]


@kernel
def condition(first, factor, further, innovation, innovation_factor, whitened, gain, posterior):
    """Write what a measurement leaves of the covariance of a state whose last few degrees of freedom have moved.

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
    factor : (n, n)
        Lower triangular factor before the step; its first n - c rows are `held`.
    further : (k, m + c)
        Further columns, as rows: noise, curvature, and the measurement's own noise.
    innovation : (m,)
    innovation_factor, whitened, gain, posterior : (m, m), (m,), (n, m), (n, n)
        Factor of the innovation's covariance, the innovation divided by it, cross-covariance times its
        inverse transpose, and factor of the state's covariance once measured. With m = 0 the last is the
        predicted one.
    """
    m = innovation_factor.shape[0]
    n = factor.shape[0]
    changing = first.shape[0] - m
    held = n - changing
    # What does not touch the held degrees of freedom is small, and triangularised alone.
    small = np.zeros((max(changing + further.shape[0], m + changing), m + changing))
    for i in range(changing):
        for r in range(m + changing):
            small[i, r] = first[r, held + i]
    small[changing : changing + further.shape[0]] = further
    triangularise(small)
    pivot = np.zeros((m, m + n))
    side = np.empty((held, m + n))
    for i in range(m):
        pivot[i, i:m] = small[i, i:m]
        pivot[i, m + held :] = small[i, m:]
    for j in range(held):
        for r in range(m):
            side[j, r] = first[r, j]
        for r in range(held):
            side[j, m + r] = factor[r, j]
        for r in range(changing):
            side[j, m + held + r] = first[m + r, j]
    # Each measurement's row is rotated into its pivot, from the last column to the first: the pivot then
    # holds nothing above the row where the column begins.
    for i in range(m):
        for j in range(held - 1, -1, -1):
            if side[j, i] == 0.0:
                continue
            length = math.sqrt(pivot[i, i] * pivot[i, i] + side[j, i] * side[j, i])
            c = pivot[i, i] / length
            s = side[j, i] / length
            rotate_rows(c, s, pivot[i, i:m], side[j, i:m])
            rotate_rows(c, s, pivot[i, m + j :], side[j, m + j :])
    for i in range(m):
        for r in range(m):
            innovation_factor[r, i] = pivot[i, r]
        for r in range(n):
            gain[r, i] = pivot[i, m + r]
    for i in range(m):
        left = innovation[i]
        for r in range(i):
            left -= innovation_factor[i, r] * whitened[r]
        whitened[i] = left / innovation_factor[i, i]
    posterior[:] = 0.0
    for j in range(held):
        for r in range(j, n):
            posterior[r, j] = side[j, m + r]
    for j in range(changing):
        for r in range(j, changing):
            posterior[held + r, held + j] = small[m + j, m + r]


@kernel
def widen(factor, index, deviation):
    """Add the square of a deviation to the variance of one degree of freedom, in place.

    factor (n, n), lower triangular: a column with one entry is rotated into it from the left; only the
    columns from `index` on change.
    """
    n = factor.shape[0]
    extra = np.zeros(n)
    extra[index] = deviation
    for j in range(index, n):
        length = math.sqrt(factor[j, j] * factor[j, j] + extra[j] * extra[j])
        c = factor[j, j] / length
        s = extra[j] / length
        for i in range(j, n):
            x = factor[i, j]
            factor[i, j] = c * x + s * extra[i]
            extra[i] = c * extra[i] - s * x


@kernel
def rotate_rows(c, s, a, b):
    """Replace rows a and b by c a + s b and c b - s a."""
    for i in range(a.size):
        x = a[i]
        y = b[i]
        a[i] = c * x + s * y
        b[i] = c * y - s * x

"""ParameterRows, columns and blocks of arrays, copied by plain loops.

An assignment of one array to another brings with it, wherever it stands, all that NumPy says of shapes that do not fit;
compiled, that is longer than most kernels.
"""

from __future__ import annotations

import numpy as np

from kreisel._kernels.arrays import Array
from kreisel._kernels.compilation import kernel

forward = np.uint64
"""An index or a bound of a loop that is never negative, as a number that cannot be.

An index with a sign may count from the end. Where a loop does not begin at zero the compiler cannot rule that out,
looks at every element by itself, and takes four times as long.
"""


@kernel
def place(block: Array, row: int, column: int, out: Array) -> None:
    """Write a block (r, c) into out (R, C) from a row and column on."""
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            out[row + i, forward(column + j)] = block[i, j]


@kernel
def column_of(points: Array, j: int) -> Array:
    """Return column j, (r,), of points (r, c)."""
    out = np.empty(points.shape[0])
    for i in range(out.size):
        out[i] = points[i, j]
    return out


@kernel
def rows_from(points: Array, at: int, size: int) -> Array:
    """Return rows of points (r, c) from row `at` on, (size, c), not copied."""
    return points[at : at + size]

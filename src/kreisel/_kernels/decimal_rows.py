"""Rows of decimal numbers between commas, from text and to text."""

from __future__ import annotations

import numpy as np

from kreisel._kernels.compiled import function
from kreisel._kernels.views import (
    Array,
    BytesView,
    IndexTableView,
    Indices,
    IndicesView,
    TableView,
    check_lengths,
)

_ODD = 1000
"""Cells of one call that are left to `float`. Chosen: plain tables have none or a few of them; a call with more returns
None, and the table is read by other means."""

_LONGEST = 17
"""Characters of a number of nine digits at most, and the one after it."""

_read_rows = function("read_rows", BytesView, IndicesView, TableView, IndexTableView, IndicesView)
_write_rows = function("write_rows", TableView, BytesView, IndicesView)


def read_rows(text: bytes, stamps: Indices, values: Array) -> int | None:
    """Write rows of numbers to values (room, columns), and return how many there are.

    Parameters
    ----------
    text
        Lines that end in a line feed; empty ones are left out.
    stamps : (room,) or (0,)
        Where to write the first column as whole numbers; (0,) if it is a column as the others.

    Returns
    -------
    int or None
        None if the table is not a regular one, and must be read by other means.

    Notes
    -----
    Numbers are rounded correctly, as `float` does. Cells of more than 19 digits, of very large or small numbers, or of
    other forms of numbers are read by `float`.
    """
    room = values.shape[0]
    check_lengths(stamps=(stamps, (room if stamps.size else 0,)))
    places, found = np.empty((_ODD, 4), dtype=np.int64), np.zeros(2, dtype=np.int64)
    _read_rows(np.frombuffer(text, dtype=np.uint8), stamps, values, places, found)
    if found[0] < 0:
        return None
    for row, column, begin, end in places[: found[1]].tolist():
        cell = text[begin:end]
        if b"_" in cell:
            return None
        try:
            values[row, column] = float(cell)
        except ValueError:
            return None
    return int(found[0])


def write_rows(values: Array) -> bytes:
    """Return lines of numbers (rows, columns), each as the format `%.9g` writes it."""
    text, found = np.empty(_LONGEST * values.size, dtype=np.uint8), np.zeros(1, dtype=np.int64)
    _write_rows(np.ascontiguousarray(values, dtype=float), text, found)
    return text[: found[0]].tobytes()

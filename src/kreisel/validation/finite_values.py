"""Numbers that can be readings, positions or angles."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.location import and_more, fault, rows
from kreisel.validation.stamp_checks import Rows

IMPOSSIBLE = 1e9
"""A number of this size or larger cannot be a reading in any unit."""


def check_finite(values: Array, names: tuple[str, ...], stream: Rows) -> None:
    """Raise an error for the first value of a stream that is of impossible size, or not a number.

    Raises
    ------
    RecordingError
        With its place.
    """
    where = np.flatnonzero(~((values > -IMPOSSIBLE) & (values < IMPOSSIBLE)).all(axis=1))
    if where.size:
        source = stream.source
        k = int(where[0])
        channel = int(np.argmin(np.abs(values[k]) < IMPOSSIBLE))
        raise fault(
            source,
            f"{names[channel]} = {values[k, channel]:.4g} is not a possible reading, here"
            f"{and_more(where.size - 1, rows(source))}; delete these {rows(source)} (a gap is bridged)",
            stream.row_of(k),
        )

"""Numbers that can be readings, positions or angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.location import and_more, fault, rows

IMPOSSIBLE = 1e9
"""A number of this size or larger cannot be a reading in any unit."""


def check_finite(values: Array, names: tuple[str, ...], source: Path) -> None:
    """Raise an error for the first value that is not a number, or that is of impossible size.

    Raises
    ------
    RecordingError
        With its place.
    """
    where = np.flatnonzero(~((values > -IMPOSSIBLE) & (values < IMPOSSIBLE)).all(axis=1))
    if where.size:
        k = int(where[0])
        channel = int(np.argmin(np.abs(values[k]) < IMPOSSIBLE))
        raise fault(
            source,
            f"{names[channel]} = {values[k, channel]:.4g} is not a possible reading, here"
            f"{and_more(where.size - 1, rows(source))}; delete these {rows(source)} (a gap is bridged)",
            k,
        )

"""Arrays that a user passes in Python."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kreisel.errors import RecordingError


def check_kind(values: ArrayLike, name: str) -> None:
    """Raise an error for arrays whose meaning would be lost: masked ones, and complex numbers.

    Raises
    ------
    RecordingError
        It begins with the name of the argument.
    """
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise RecordingError(f"{name}: some values are masked; remove these rows")
    if getattr(getattr(values, "dtype", None), "kind", "f") == "c":
        raise RecordingError(f"{name}: complex numbers, expected real ones")

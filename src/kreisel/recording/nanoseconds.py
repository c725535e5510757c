"""Times as whole nanoseconds."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.recording.recording import Stamps


def in_nanoseconds(times: Array, unit_ns: float) -> Stamps:
    """Return times (n,) in units of so many nanoseconds as whole nanoseconds.

    In two parts: seconds since 1970 times 1e9 have no digits left after the point.
    """
    whole = np.floor(times)
    exact = unit_ns == int(unit_ns)
    ns = whole.astype(np.int64) * int(unit_ns) if exact else np.round(whole * unit_ns).astype(np.int64)
    return np.asarray(ns + np.round((times - whole) * unit_ns).astype(np.int64))

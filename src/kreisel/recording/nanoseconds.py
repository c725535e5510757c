"""Times as whole nanoseconds."""

from __future__ import annotations

from datetime import UTC, datetime

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


_CENTURY_NS = 946_684_800_000_000_000
"""2000-01-01; earlier stamps are no dates."""


def date_of_stamp(stamp_ns: int | None) -> str | None:
    """Return the date of a stamp, UTC, ISO; None where it is none, as of a clock that begins with the device."""
    if stamp_ns is None or stamp_ns < _CENTURY_NS:
        return None
    try:
        return datetime.fromtimestamp(stamp_ns * 1e-9, tz=UTC).date().isoformat()
    except (OverflowError, ValueError):
        return None

"""Overlapping Allan deviation, checked against the published one of an ADIS16405 in tests/published/test_allan.py."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def allan_deviation(values: Array, interval: float, clusters: Array) -> Array:
    """Return the overlapping Allan deviation (m, 3) of readings (n, 3).

    Parameters
    ----------
    interval
        Time between two readings, s.
    clusters : (m,)
        Readings averaged together; each at most half of all less one.

    Notes
    -----
    IEEE 952-1997, annex C.
    """
    angle = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)]) * interval
    out = np.empty((len(clusters), values.shape[1]))
    for i, m in enumerate(clusters):
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        out[i] = np.sqrt(np.mean(second**2, axis=0) / 2.0) / (m * interval)
    return out

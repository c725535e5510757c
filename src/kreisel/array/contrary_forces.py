"""The IMUs of an array whose accelerations are not those of the others, turned as their rates are."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from kreisel.array.hand_motion import HandMotion
from kreisel.geometry.rotation import Array

_FAR = 0.5
"""Distance (of Frobenius) of a matrix between two IMUs' forces from that of no change, from which they contradict each
other. Chosen: a sign is a distance of 2, two axes that are swapped too, and 20 degrees between a device's
accelerometers and its gyros are 0.5."""

_SHOWN = 1.0
"""m/s^2, rms: forces along a direction by which the matrix is shown. Chosen: gravity is ten times as much."""

CONTRARY = (
    "its accelerations are not those of the others, turned as its rates are: a column is in another place, has another "
    "sign, or reads wrong"
)
"""What is said of such an IMU."""


def contrary_forces(motion: HandMotion) -> tuple[int, ...] | None:
    """Return the numbers of the IMUs that contradict most others; None where no majority agrees.

    One whose accelerations all have the other sign is among them, if the others have not.
    """
    count = len(motion.forces)
    forces, by_place = motion.in_common(motion.forces), motion.by_place
    agrees = np.eye(count, dtype=bool)
    for j, k in combinations(range(count), 2):
        agrees[j, k] = agrees[k, j] = np.linalg.norm(_matrix(forces[j], forces[k], by_place) - np.eye(3)) < _FAR
    most = int(np.argmax(agrees.sum(axis=1)))
    if 2 * int(agrees[most].sum()) <= count:
        return None
    return tuple(np.flatnonzero(~agrees[most]).tolist())


def _matrix(own: Array, other: Array, by_place: Array) -> Array:
    """Return the matrix M (3, 3) with other = M own + a part by the distance between the two + an offset.

    Where forces do not show it, it is that of no change.
    """
    n = len(own)
    X = np.zeros((n, 3, 15))
    for j in range(3):
        X[:, j, 3 * j : 3 * j + 3], X[:, j, 9 + j] = own, 1.0
    X[:, :, 12:] = by_place
    A = np.einsum("nip,niq->pq", X, X) / n
    b = np.einsum("nip,ni->p", X, other - own) / n
    A[:9, :9] += _SHOWN**2 * np.eye(9)
    return np.asarray(np.eye(3) + np.linalg.lstsq(A, b, rcond=1e-12)[0][:9].reshape(3, 3))

"""Whether a unit turned on its mount during the recording, by its differences from the others' motion.

A turn changes what both its gyros and its accelerometers show, by the same rotation; a change of offsets, which is
common, is left free at the same time. What only one of the two shows is no turn of the mount.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.sudden_change import excess_of_steps, from_here
from kreisel.geometry.rotation import Array, Mask

_SURE = 45.0
"""Chi-square with three degrees of freedom of the likeliest turn, from which it counts. Chosen: probability 1e-9 for
one moment, and 1e-6 with the moments of a recording and the units of a large tray."""

_EACH = 11.3
"""Chi-square with three degrees of freedom that gyros and accelerometers each need: probability 0.01."""

_DIFFERENT = 21.1
"""Chi-square with three degrees of freedom by which the turns of both may differ: probability 1e-4."""

_DETERMINED = 1e12
"""Condition up to which a turn, or a change of offsets, is determined."""

_EDGE = 3
"""Parts at either end in which no turn is looked for."""


@dataclass(frozen=True)
class RowParts:
    """Sums over parts of the recording, for each triad (gyros, accelerometers).

    Attributes
    ----------
    seconds : (parts + 1,)
        Where parts begin, and the last one ends.
    info, score : (2, parts, 6, 6), (2, parts, 6)
        Of a turn of the unit (rad, in b) and a change of its offsets, if they began with the part.
    cross : (2, parts, 6, p)
        With all parameters.
    whole : (p, p)
        Information about all parameters.
    """

    seconds: Array
    info: Array
    score: Array
    cross: Array
    whole: Array


@dataclass(frozen=True)
class Turn:
    """A turn of a unit on its mount.

    Attributes
    ----------
    seconds
        When, on the clock of the base unit.
    angle, deviation : (3,)
        Rotation vector in b, rad.
    weight
        Chi-square by which the data show it.
    """

    seconds: float
    angle: Array
    deviation: Array
    weight: float


def turn_of(parts: RowParts) -> Turn | None:
    """Return the turn of a unit on its mount, if the data show one."""
    inverse = np.asarray(np.linalg.inv(parts.whole), dtype=float)
    (a, A, seen_a), (b, B, seen_b) = (_estimates(parts, triad, inverse) for triad in range(2))
    k = _EDGE + np.flatnonzero((seen_a & seen_b)[_EDGE : len(a) - _EDGE])
    if k.size == 0:
        return None
    a, A, b, B = a[k], A[k], b[k], B[k]
    information = A + B
    angle = _solved(information, _times(A, a) + _times(B, b))
    weight, each = _square(angle, information), np.minimum(_square(a, A), _square(b, B))
    best = int(np.argmax(weight))
    apart = a[best] - b[best]
    different = float(apart @ np.linalg.solve(np.linalg.inv(A[best]) + np.linalg.inv(B[best]), apart))
    if weight[best] < _SURE or each[best] < _EACH or different > max(_DIFFERENT, 0.05 * float(weight[best])):
        return None
    deviation = np.sqrt(np.diag(np.linalg.inv(information[best])))
    return Turn(float(parts.seconds[k[best]]), angle[best], deviation, float(weight[best]))


def _estimates(parts: RowParts, triad: int, inverse: Array) -> tuple[Array, Array, Mask]:
    """Return turns (k, 3) before each part by one triad, their information (k, 3, 3), and which are determined.

    Offsets are free, all parameters too.
    """
    cross, info, score = (from_here(own[triad]) for own in (parts.cross, parts.info, parts.score))
    V = info - cross @ inverse @ np.swapaxes(cross, 1, 2)
    offsets = V[:, 3:, 3:]
    seen = np.linalg.cond(offsets) < _DETERMINED
    gain = V[:, :3, 3:] @ np.linalg.inv(np.where(seen[:, None, None], offsets, np.eye(3)))
    W, v = V[:, :3, :3] - gain @ V[:, 3:, :3], score[:, :3] - _times(gain, score[:, 3:])
    seen &= np.linalg.cond(W) < _DETERMINED
    W = np.where(seen[:, None, None], W, np.eye(3))
    return _solved(W, v), W / _scatter(parts, triad), seen


def _times(M: Array, v: Array) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", M, v))


def _solved(M: Array, v: Array) -> Array:
    return np.asarray(np.linalg.solve(M, v[..., None])[..., 0])


def _square(v: Array, M: Array) -> Array:
    return np.asarray(np.einsum("ki,kij,kj->k", v, M, v))


def _scatter(parts: RowParts, triad: int) -> float:
    """Return by how much variances of the parts' own turns exceed those by the noise, 1 at least.

    Differences of neighbours are taken, so that a turn does not count.
    """
    info, score = parts.info[triad][:, :3, :3], parts.score[triad][:, :3]
    rich = np.linalg.cond(info) < 1e4
    own = np.zeros_like(score)
    covariance = np.zeros_like(info)
    own[rich] = np.linalg.solve(info[rich], score[rich][..., None])[..., 0]
    covariance[rich] = np.linalg.inv(info[rich])
    both = np.flatnonzero(rich[1:] & rich[:-1])
    if both.size < 8:
        return 1.0
    return excess_of_steps(own[both + 1] - own[both], covariance[both] + covariance[both + 1])

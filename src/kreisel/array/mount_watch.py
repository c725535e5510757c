"""Whether a unit turned on its mount during the recording, by its differences from the others' motion.

A turn changes what both its gyros and its accelerometers show, by the same rotation; a change of offsets, which is
common, is left free at the same time. What only one of the two shows is no turn of the mount.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.unit_fit import RowParts
from kreisel.geometry.rotation import Array

_SURE = 45.0
"""Chi-square with three degrees of freedom of the likeliest turn, from which it counts. Chosen: probability 1e-9 for
one moment, and 1e-6 with the moments of a recording and the units of a large tray."""

_EACH = 11.3
"""Chi-square with three degrees of freedom that gyros and accelerometers each need: probability 0.01."""

_DIFFERENT = 21.1
"""Chi-square with three degrees of freedom by which the turns of both may differ: probability 1e-4."""

_MEDIAN = 2.366
"""Median of chi-square with three degrees of freedom."""

_EDGE = 3
"""Parts at either end in which no turn is looked for."""


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
    count = parts.info.shape[1]
    inverse = np.asarray(np.linalg.inv(parts.whole), dtype=float)
    noise = [_scatter(parts, triad) for triad in range(2)]
    best = None
    for k in range(_EDGE, count - _EDGE):
        found = [_estimate(parts, triad, k, inverse, noise[triad]) for triad in range(2)]
        if found[0] is None or found[1] is None:
            continue
        (a, A), (b, B) = found[0], found[1]
        information = A + B
        angle = np.asarray(np.linalg.solve(information, A @ a + B @ b), dtype=float)
        weight = float(angle @ information @ angle)
        if best is None or weight > best[0]:
            apart = float((a - b) @ np.linalg.solve(np.linalg.inv(A) + np.linalg.inv(B), a - b))
            best = weight, k, angle, information, min(float(a @ A @ a), float(b @ B @ b)), apart
    if best is None or best[0] < _SURE or best[4] < _EACH or best[5] > max(_DIFFERENT, 0.05 * best[0]):
        return None
    weight, k, angle, information = best[:4]
    return Turn(float(parts.seconds[k]), angle, np.sqrt(np.diag(np.linalg.inv(information))), weight)


def _estimate(parts: RowParts, triad: int, k: int, inverse: Array, noise: float) -> tuple[Array, Array] | None:
    """Return the turn before part k by one triad, and its information; offsets are free, all parameters too."""
    cross = parts.cross[triad, k:].sum(axis=0)
    V = parts.info[triad, k:].sum(axis=0) - cross @ inverse @ cross.T
    u = parts.score[triad, k:].sum(axis=0)
    offsets = V[3:, 3:]
    if np.linalg.cond(offsets) > 1e12:
        return None
    gain = V[:3, 3:] @ np.linalg.inv(offsets)
    W, v = V[:3, :3] - gain @ V[3:, :3], u[:3] - gain @ u[3:]
    if np.linalg.cond(W) > 1e12:
        return None
    return np.linalg.solve(W, v), W / noise


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
    d = own[both + 1] - own[both]
    chi = np.einsum("mi,mij,mj->m", d, np.linalg.inv(covariance[both] + covariance[both + 1]), d)
    return max(1.0, float(np.median(chi)) / _MEDIAN)

"""Whether an IMU of an array slid on the body at some moment: its accelerometers then feel another place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.array.hand_motion import HandMotion
from kreisel.array.sudden_change import (
    ALONE,
    DRIFT,
    OF_TWO,
    SURE,
    alike_parts,
    clearest,
    in_parts,
    spikes_in,
    sums_of,
    without,
)
from kreisel.geometry.rotation import Array

_LEAST = 1e-3
"""m: smallest slide that counts. Chosen: plates bend, and accelerometers of a unit lie apart, by tenths of that."""


@dataclass(frozen=True)
class Slide:
    """The number of an IMU, when it slid, s, how far, m, and the chi-square by which the data show it."""

    number: int
    seconds: float
    size: float
    weight: float

    @property
    def text(self) -> str:
        """What is said of it."""
        return f"slides on the others' body by {1e3 * self.size:.2g} mm at about {self.seconds:.0f} s: fasten it"


def sudden_slide(motion: HandMotion) -> Slide | None:
    """Return the clearest slide of an IMU against all others, if there is one; of two, the second one slides."""
    forces, slopes = motion.in_common(motion.forces), motion.in_common(motion.force_slopes)
    count = len(forces)
    units = range(1 if count == 2 else 0, count)
    found = [one for k in units if (one := _slide(k, motion, forces, slopes)) is not None]
    found.sort(key=lambda one: -one.size)
    usual = found[1].size * ALONE if len(found) > 1 else _LEAST * (OF_TWO if count == 2 else 1.0)
    return found[0] if found and found[0].size > max(usual, _LEAST) else None


def _slide(number: int, motion: HandMotion, forces: Array, slopes: Array) -> Slide | None:
    own = forces[number]
    others = np.delete(forces, number, axis=0).mean(axis=0)
    by_place = motion.by_place
    late, part = in_parts(motion.seconds)
    lasting = _lasting(others, np.delete(slopes, number, axis=0).mean(axis=0), by_place, late)
    best: Slide | None = None
    for group in alike_parts(motion.mean, part):
        used = group[part]
        if not used.any():
            continue
        left = own[used] - others[used]
        smooth = ~spikes_in(left)[:, None]
        what, alike = by_place[used] * smooth[:, :, None], lasting[used] * smooth[:, :, None]
        sums = sums_of(part[used], what, alike, without(alike, left * smooth))
        k, size, weight, _ = clearest(*sums, np.flatnonzero(group))
        if weight > max(SURE, 0.0 if best is None else best.weight):
            when = float(motion.seconds[0] + (motion.seconds[-1] - motion.seconds[0]) * k / group.size)
            best = Slide(number, when, size, weight)
    return best


def _lasting(others: Array, slopes: Array, by_place: Array, late: Array) -> Array:
    """Return what is alike all the time, or changes slowly, (n, 3, 25): a matrix, offsets, a place and a delay."""
    X = np.zeros((len(others), 3, 25))
    drift = late[:, None] ** np.arange(DRIFT + 1)
    for j in range(3):
        X[:, j, 3 * j : 3 * j + 3] = others
        X[:, j, 9 + 4 * j : 13 + 4 * j] = drift
    X[:, :, 21:24], X[:, :, 24] = by_place, slopes
    return X

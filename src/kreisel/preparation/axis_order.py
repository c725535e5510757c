"""Whether accelerometers and gyros have the same axes: columns in the wrong order, or with wrong signs, otherwise."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, nearest_rotation

MAX_TURN = 30.0
"""Degrees the accelerometers' axes may be turned against the gyros'; beyond it, columns are in the wrong order."""

LEFT_HANDED_GYROS = (
    "the gyro axes form a left-handed triad (the determinant of their cross-coupling is negative): one axis, or all "
    "three, have the wrong sign, or two columns are swapped; correct signs and order of the columns"
)
"""What is said of gyros that turn the wrong way."""


def turn_between(K_omega: Array, K_a: Array) -> Array:
    """Return the orthogonal matrix, of any handedness, that takes accelerations as read to the gyros' axes.

    Of gyros that are a right-handed triad.
    """
    U, _, V = np.linalg.svd(nearest_rotation(K_omega).T @ K_a)
    return np.asarray(U @ V)


def disorder(F: Array) -> str | None:
    """Return what is wrong with accelerometers whose axes a matrix F takes to the gyros'; None if nothing is."""
    if np.linalg.det(F) < 0.0:
        return (
            f"the accelerometers form a left-handed triad against the gyros ({order(F)}); correct signs and order "
            "of their columns"
        )
    if angle(F) > MAX_TURN and in_order(F):
        return (
            f"the accelerometers' axes are rotated by {angle(F):.0f} deg against the gyros': they are mounted so, "
            "which is not supported, or positions and orientations are not of the same body and run"
        )
    if angle(F) > MAX_TURN:
        return (
            f"the accelerometers' axes are rotated by {angle(F):.0f} deg against the gyros' ({order(F)}); write the "
            "columns of both in the same order, with the same signs"
        )
    return None


def in_order(F: Array) -> bool:
    """Return whether each reading lies along the gyros' axis of the same name, more than along others."""
    return bool((np.diag(F) > 0.0).all() and (np.argmax(np.abs(F), axis=1) == np.arange(3)).all())


def angle(F: Array) -> float:
    """Return the angle of a rotation matrix in degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(F) - 1.0) / 2.0, -1.0, 1.0))))


def order(F: Array) -> str:
    """Return as text which reading lies along which of the gyros' axes."""
    names = []
    for row, axis in zip(F, "xyz", strict=True):
        j = int(np.argmax(np.abs(row)))
        names.append(f"{'-' if row[j] < 0.0 else ''}a_{'xyz'[j]} lies along w_{axis}")
    return ", ".join(names)

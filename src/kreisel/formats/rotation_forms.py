"""Rotations as people write them: quaternions, Euler angles, rotation vectors, matrices."""

from __future__ import annotations

import re

import numpy as np

from kreisel.errors import RecordingError, SettingsError
from kreisel.geometry.rotation import Array, exp, from_matrix, multiply
from kreisel.validation.empty_rows import all_alike

FORMS = (
    "quaternion wxyz", "quaternion xyzw", "euler ZYX", "euler xyz", "kuka abc", "rotation vector", "matrix",
    "pose matrix",
)  # fmt: skip
"""Forms, two of them as examples of all sequences of Euler angles.

Capital letters turn about the axes of the body as it turns (intrinsic), small letters about the fixed axes (extrinsic),
in the order in which they are written. KUKA's A, B, C are ZYX.
"""

_NOT_ORTHOGONAL = 0.02
"""Largest deviation of a matrix times its transpose from the identity. Chosen: a rotation written with two decimals has
0.018 at most, 2 sqrt(3) times 0.005; columns in a wrong order have deviations near 1."""

_EULER = re.compile(r"euler\s+([xyz]{3}|[XYZ]{3})")


def columns_of(form: str) -> tuple[int, ...]:
    """Return the numbers of columns a form may have.

    Raises
    ------
    SettingsError
        For an unknown form.
    """
    if form in ("quaternion wxyz", "quaternion xyzw"):
        return (4,)
    if form == "matrix":
        return (9,)
    if form == "pose matrix":
        return (12, 16)
    if form in ("kuka abc", "rotation vector"):
        return (3,)
    if _EULER.fullmatch(form) and form[-3] != form[-2] != form[-1]:
        return (3,)
    raise SettingsError(f"'{form}' is not a form of rotations; known: {', '.join(FORMS)}, and other sequences of axes")


def quantity_of(form: str) -> str:
    """Return the quantity whose units the numbers of a form may have."""
    if form in ("kuka abc", "rotation vector") or form.startswith("euler"):
        return "angle"
    return "length" if form == "pose matrix" else "quaternion"


def quaternions_of(form: str, values: Array) -> Array:
    """Return quaternions (n, 4), scalar first, of numbers (n, k) in a form; angles in rad.

    Matrices are read row by row, and made orthogonal; of a pose matrix (3x4 or 4x4) the rotation alone is taken.
    Numbers that are not finite give NaN, and so do matrices whose numbers are all the same: they mark what was lost.
    """
    if form == "quaternion wxyz":
        return values
    if form == "quaternion xyzw":
        return np.roll(values, 1, axis=1)
    good = np.isfinite(values).all(axis=1)
    if "matrix" in form:
        good &= ~all_alike(values)
    out = np.full((len(values), 4), np.nan)
    out[good] = _converted(form, values[good])
    return out


def _converted(form: str, values: Array) -> Array:
    if form == "rotation vector":
        return exp(values)
    if form in ("matrix", "pose matrix"):
        whole = values.reshape(len(values), -1, 3 if form == "matrix" else 4)
        _check_matrices(whole)
        u, _, v = np.linalg.svd(whole[:, :3, :3])
        return from_matrix(u @ v)
    sequence = "ZYX" if form == "kuka abc" else form.split()[1]
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(values), 1))
    for axis, angle in zip(sequence, values.T, strict=True):
        turn = exp(angle[:, None] * np.eye(3)["xyz".index(axis.lower())])
        q = multiply(q, turn) if sequence.isupper() else multiply(turn, q)
    return q


def _check_matrices(whole: Array) -> None:
    """Raise an error for matrices (n, 3 or 4, 3 or 4) that are no rotations."""
    if whole.shape[1] == 4 and np.abs(whole[:, 3] - [0.0, 0.0, 0.0, 1.0]).max() > _NOT_ORTHOGONAL:
        column = np.abs(whole[:, :, 3] - [0.0, 0.0, 0.0, 1.0]).max() < _NOT_ORTHOGONAL
        hint = "they are written column by column: name the columns row by row" if column else "check the columns"
        raise RecordingError(f"the last row of the pose matrices is not 0, 0, 0, 1; {hint}")
    C = whole[:, :3, :3]
    off = np.abs(C @ np.swapaxes(C, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(off > _NOT_ORTHOGONAL)
    if bad.size:
        raise RecordingError(
            f"{bad.size} of {len(C)} matrices are no rotations (the first is number {int(bad[0]) + 1}, its rows are "
            f"orthogonal to {off[bad[0]]:.2g} only); check the columns, and delete rows in which tracking was lost"
        )
    if (np.linalg.det(C) < 0.0).any():
        raise RecordingError("the matrices are left-handed: they mirror the body; check columns and signs")


def positions_of(values: Array) -> Array:
    """Return the positions (n, 3) in pose matrices of 12 or 16 numbers."""
    return np.ascontiguousarray(values.reshape(len(values), -1, 4)[:, :3, 3])

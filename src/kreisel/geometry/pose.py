"""Exponential and logarithm of rigid motions: a rotation matrix and a translation from six small numbers, and back."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, exp, from_matrix, log, matrix, skew

_SMALL = 1e-3
"""rad; below it closed forms lose digits, and the first terms of their series are exact to rounding."""


def exp_motion(xi: Array) -> tuple[Array, Array]:
    """Return rotation matrix (3, 3) and translation (3,) of a motion xi (6,): translation, then rotation vector.

    Notes
    -----
    The exponential of SE(3): the translation is V rho, with V = I + a [theta x] + b [theta x]^2.
    """
    rho, theta = xi[:3], xi[3:]
    angle = float(np.linalg.norm(theta))
    if angle < _SMALL:
        a, b = 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    else:
        a, b = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    turn = np.cross(theta, rho)
    return matrix(exp(theta)), np.asarray(rho + a * turn + b * np.cross(theta, turn))


def log_motion(C: Array, p: Array) -> Array:
    """Return the motion (6,) whose exponential is the rotation matrix C (3, 3) and the translation p (3,)."""
    theta = log(from_matrix(C))
    angle = float(np.linalg.norm(theta))
    half = 0.5 * angle
    c = 1.0 / 12.0 + angle**2 / 720.0 if angle < _SMALL else (1.0 - half / np.tan(half)) / angle**2
    W = skew(theta)
    return np.concatenate([p - 0.5 * W @ p + c * W @ W @ p, theta])

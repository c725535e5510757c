"""Quaternions of the oracle: scalar first, Hamilton; any leading axes; plain NumPy."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product a * b."""
    a0, a1, a2, a3 = np.moveaxis(a, -1, 0)
    b0, b1, b2, b3 = np.moveaxis(b, -1, 0)
    product = [
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1,
        a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0,
    ]
    return np.stack(product, axis=-1)


def conjugate(q: Array) -> Array:
    """Return the inverse of a unit quaternion."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def normalized(q: Array) -> Array:
    """Return q / |q|."""
    return q / _length(q)


def _length(x: Array) -> Array:
    """Return |x|, (..., 1), as a function that complex steps go through."""
    return np.asarray(np.sqrt(np.sum(x * x, axis=-1, keepdims=True)))


def exp(phi: Array) -> Array:
    """Return the unit quaternion of the rotation vector phi (rad)."""
    half = 0.5 * _length(phi)
    # np.sinc divides by its argument safely at zero.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * phi], axis=-1)


def log(q: Array) -> Array:
    """Return the rotation vector of q (rad), of angle at most pi, whatever the sign of q."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    tiny = sine < 1e-150
    return np.where(tiny, 2.0, angle / np.where(tiny, 1.0, sine)) * q[..., 1:]


def rotate(q: Array, u: Array) -> Array:
    """Return C(q) u."""
    axis = q[..., 1:]
    twice = 2.0 * np.cross(axis, u)
    return u + q[..., :1] * twice + np.cross(axis, twice)


def rotate_back(q: Array, u: Array) -> Array:
    """Return C(q)^T u."""
    return rotate(conjugate(q), u)


def matrix(q: Array) -> Array:
    """Return C(q), its columns the images of the unit vectors."""
    return np.stack([rotate(q, e) for e in np.eye(3)], axis=-1)


def skew(u: Array) -> Array:
    """Return [u x], the matrix of the cross product u x."""
    x, y, z = np.moveaxis(u, -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, axis=-1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    return np.stack(rows, axis=-2)

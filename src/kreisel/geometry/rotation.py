"""Exponential and logarithm, products and actions of rotations; lengths of vectors."""

from __future__ import annotations

from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


def lengths(vectors: NDArray[np.floating[Any]]) -> Array:
    """Return the lengths (...) of vectors (..., n); several times as fast as `np.linalg.norm` for short ones."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def mean_row(values: Array) -> Array:
    """Return the mean of rows (n, k), (k,); the product with a row is faster than a sum along the long axis."""
    return np.asarray(np.full(len(values), 1.0 / max(len(values), 1)) @ values)


def exp(theta: ArrayLike) -> Array:
    """Return the unit quaternions (..., 4) of the rotation vectors theta (..., 3), in rad."""
    theta = np.asarray(theta, dtype=float)
    half = 0.5 * lengths(theta)[..., None]
    safe = np.where(half > 0.0, half, 1.0)
    ratio = np.where(half > 0.0, np.sin(half) / safe, 1.0)
    return np.concatenate([np.cos(half), 0.5 * ratio * theta], axis=-1)


def log(q: ArrayLike) -> Array:
    """Return the rotation vectors (..., 3) in rad, at most pi long, of the unit quaternions q (..., 4)."""
    q = np.asarray(q, dtype=float)
    vector = q[..., 1:]
    length = lengths(vector)[..., None]
    scalar = q[..., :1]
    sign = np.where(scalar < 0.0, -1.0, 1.0)
    safe = np.where(length > 0.0, length, 1.0)
    ratio = np.where(length > 0.0, 2.0 * np.arctan2(length, np.abs(scalar)) / safe, 2.0)
    return np.asarray(sign * ratio * vector)


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the Hamilton products a * b of quaternions (..., 4)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


def conjugate(q: ArrayLike) -> Array:
    """Return the inverse of unit quaternions (..., 4)."""
    return np.asarray(q, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0])


def apply(q: ArrayLike, v: ArrayLike) -> Array:
    """Return the vectors v (..., 3) turned by q (..., 4): ``C(q) v``."""
    q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
    t = 2.0 * np.cross(q[..., 1:], v)
    return np.asarray(v + q[..., :1] * t + np.cross(q[..., 1:], t))


def matrix(q: ArrayLike) -> Array:
    """Return the direction cosine matrices (..., 3, 3) of unit quaternions (..., 4)."""
    q = np.asarray(q, dtype=float)
    w, x, y, z = np.moveaxis(q, -1, 0)
    return _matrices(
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _matrices(*rows: tuple[Array, ...]) -> Array:
    """Return matrices (..., 3, 3) of entries (...)."""
    out = np.empty((*np.shape(rows[0][0]), 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    return out


def from_matrix(C: ArrayLike) -> Array:
    """Return the unit quaternion (..., 4) of direction cosine matrices (..., 3, 3).

    The products 4 q q^T are sums of the matrix' entries; of their rows the one with the largest diagonal is taken.
    """
    C = np.asarray(C, dtype=float)
    x, y, z = C[..., 0, 0], C[..., 1, 1], C[..., 2, 2]
    products = np.empty((*C.shape[:-2], 4, 4))
    for i, diagonal in enumerate((1.0 + x + y + z, 1.0 + x - y - z, 1.0 - x + y - z, 1.0 - x - y + z)):
        products[..., i, i] = diagonal
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., 0, 1 + i] = products[..., 1 + i, 0] = C[..., k, j] - C[..., j, k]
        products[..., 1 + i, 1 + j] = products[..., 1 + j, 1 + i] = C[..., i, j] + C[..., j, i]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def from_two_vectors(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the quaternion (4,) of the smallest rotation that turns the direction of a into that of b."""
    u, v = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    w = 0.5 * float(np.linalg.norm(u + v))  # cosine of half the angle; 1 + u . v would lose digits for opposite vectors
    if w < 1e-8:
        axis = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
        return np.concatenate([[0.0], axis / np.linalg.norm(axis)])
    q = np.concatenate([[w], np.cross(u, v) / (2.0 * w)])
    return np.asarray(q / np.linalg.norm(q))


def roll_pitch_yaw(C: Array) -> tuple[float, float, float]:
    """Return the angles of R = Rz(yaw) Ry(pitch) Rx(roll); at a pitch of 90 deg, not unique, they fit together."""
    yaw = np.arctan2(C[1, 0], C[0, 0])
    pitch = np.arctan2(-C[2, 0], np.hypot(C[0, 0], C[1, 0]))
    sine, cosine = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(sine * C[0, 2] - cosine * C[1, 2], cosine * C[1, 1] - sine * C[0, 1])
    return float(roll), float(pitch), float(yaw)


def nearest_rotation(M: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) nearest to M (..., 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(np.asarray(M, dtype=float))
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def right_angle_turns() -> list[Array]:
    """Return the 24 rotation matrices (3, 3) that turn axes into axes."""
    turns = [
        np.eye(3)[:, list(order)] * signs for order in permutations(range(3)) for signs in product((1, -1), repeat=3)
    ]
    return [turn for turn in turns if np.linalg.det(turn) > 0.0]


def skew(v: ArrayLike) -> Array:
    """Return the matrices [v x] (..., 3, 3), with ``skew(v) @ u == cross(v, u)``."""
    v = np.asarray(v, dtype=float)
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return _matrices((zero, -z, y), (z, zero, -x), (-y, x, zero))

"""Quaternions, scalar first, one in each column of a (4, m) array."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels.arrays import Array
from kreisel._kernels.compilation import kernel


@kernel
def turn(q: Array, theta: Array, sign: float) -> None:
    """Turn every quaternion on its right by the rotation vector sign * theta, |theta| below one radian.

    q: (4, m), changed in place; theta: (3, m). Cosine and sinc are their series to the 12th power of the
    half angle, which for one radian leaves less than the rounding error and needs no branch.
    """
    for s in range(q.shape[1]):
        x = 0.5 * sign * theta[0, s]
        y = 0.5 * sign * theta[1, s]
        z = 0.5 * sign * theta[2, s]
        h = x * x + y * y + z * z
        c = 1.0 - h / 2.0 * (
            1.0 - h / 12.0 * (1.0 - h / 30.0 * (1.0 - h / 56.0 * (1.0 - h / 90.0 * (1.0 - h / 132.0))))
        )
        k = 1.0 - h / 6.0 * (
            1.0 - h / 20.0 * (1.0 - h / 42.0 * (1.0 - h / 72.0 * (1.0 - h / 110.0 * (1.0 - h / 156.0))))
        )
        x *= k
        y *= k
        z *= k
        a = q[0, s]
        b = q[1, s]
        d = q[2, s]
        e = q[3, s]
        q[0, s] = a * c - b * x - d * y - e * z
        q[1, s] = a * x + b * c + d * z - e * y
        q[2, s] = a * y - b * z + d * c + e * x
        q[3, s] = a * z + b * y - d * x + e * c


@kernel
def rotate(q: Array, vector: Array) -> None:
    """Turn vectors (3, m), in place, by quaternions (4, m)."""
    for s in range(q.shape[1]):
        w = q[0, s]
        x = q[1, s]
        y = q[2, s]
        z = q[3, s]
        a = vector[0, s]
        b = vector[1, s]
        c = vector[2, s]
        # t = 2 q x v; v + w t + q x t
        tx = 2.0 * (y * c - z * b)
        ty = 2.0 * (z * a - x * c)
        tz = 2.0 * (x * b - y * a)
        vector[0, s] = a + w * tx + (y * tz - z * ty)
        vector[1, s] = b + w * ty + (z * tx - x * tz)
        vector[2, s] = c + w * tz + (x * ty - y * tx)


@kernel
def plus(q: Array, theta: Array, out: Array) -> None:
    """Write q * exp(theta) for columns: q (4, m) or (4, 1), theta (3, m), angles of any size; out (4, m) may be q."""
    m = theta.shape[1]
    one = q.shape[1] == 1
    largest = 0.0
    for s in range(m):
        largest = max(largest, theta[0, s] ** 2 + theta[1, s] ** 2 + theta[2, s] ** 2)
    if largest < 1.0:
        for i in range(4):
            for s in range(m):
                out[i, s] = q[i, 0 if one else s]
        turn(out, theta, 1.0)
        return
    for s in range(m):
        j = 0 if one else s
        x = theta[0, s]
        y = theta[1, s]
        z = theta[2, s]
        half = 0.5 * math.sqrt(x * x + y * y + z * z)
        k = 0.5 if half == 0.0 else 0.5 * math.sin(half) / half
        w = math.cos(half)
        x *= k
        y *= k
        z *= k
        a, b, c, d = q[0, j], q[1, j], q[2, j], q[3, j]
        out[0, s] = a * w - b * x - c * y - d * z
        out[1, s] = a * x + b * w + c * z - d * y
        out[2, s] = a * y - b * z + c * w + d * x
        out[3, s] = a * z + b * y - c * x + d * w


@kernel
def minus(q: Array, origin: Array, out: Array) -> None:
    """Write log(origin^-1 * q) for columns: q (4, m), origin (4, 1), out (3, m), at most pi long."""
    a = origin[0, 0]
    b = -origin[1, 0]
    c = -origin[2, 0]
    d = -origin[3, 0]
    m = q.shape[1]
    real = np.empty(m)
    largest = 0.0
    for s in range(m):
        w = a * q[0, s] - b * q[1, s] - c * q[2, s] - d * q[3, s]
        x = a * q[1, s] + b * q[0, s] + c * q[3, s] - d * q[2, s]
        y = a * q[2, s] - b * q[3, s] + c * q[0, s] + d * q[1, s]
        z = a * q[3, s] + b * q[2, s] - c * q[1, s] + d * q[0, s]
        real[s] = w
        out[0, s] = x
        out[1, s] = y
        out[2, s] = z
    for s in range(m):
        largest = max(largest, out[0, s] ** 2 + out[1, s] ** 2 + out[2, s] ** 2)
    if largest < 0.01:
        for s in range(m):
            h = out[0, s] ** 2 + out[1, s] ** 2 + out[2, s] ** 2
            # the series of arcsine, whose next term is below 2e-16 here
            far = 35.0 / 576.0 + h * (63.0 / 1408.0 + h * (231.0 / 6656.0 + h * 143.0 / 5120.0))
            k = 2.0 + h * (1.0 / 3.0 + h * (3.0 / 20.0 + h * (5.0 / 56.0 + h * far)))
            k = -k if real[s] < 0.0 else k
            out[0, s] *= k
            out[1, s] *= k
            out[2, s] *= k
        return
    for s in range(m):
        length = math.sqrt(out[0, s] ** 2 + out[1, s] ** 2 + out[2, s] ** 2)
        k = 2.0 if length == 0.0 else 2.0 * math.atan2(length, abs(real[s])) / length
        k = -k if real[s] < 0.0 else k
        out[0, s] *= k
        out[1, s] *= k
        out[2, s] *= k


@kernel
def direction_cosines(q: Array, C: Array) -> None:
    """Write the matrices of unit quaternions (c, 4), row by row, (c, 9)."""
    for j in range(q.shape[0]):
        w, x, y, z = q[j, 0], q[j, 1], q[j, 2], q[j, 3]
        C[j, 0] = 1.0 - 2.0 * (y * y + z * z)
        C[j, 1] = 2.0 * (x * y - w * z)
        C[j, 2] = 2.0 * (x * z + w * y)
        C[j, 3] = 2.0 * (x * y + w * z)
        C[j, 4] = 1.0 - 2.0 * (x * x + z * z)
        C[j, 5] = 2.0 * (y * z - w * x)
        C[j, 6] = 2.0 * (x * z - w * y)
        C[j, 7] = 2.0 * (y * z + w * x)
        C[j, 8] = 1.0 - 2.0 * (x * x + y * y)

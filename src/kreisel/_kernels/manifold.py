"""Small changes of a state made of vectors and rotations, and the way back."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels.compilation import kernel

DEGREE, DEGREES, STORED, ROTATION = range(4)
"""Columns of a table of parts: first degree of freedom, how many, first stored number, whether a rotation."""


@kernel
def plus(parts, x, change, out):
    """Write the states (size, m) that lie changes (degrees, m) away from the state x (size,).

    parts (p, 4): see `DEGREE`. Rotations are stored as quaternions and changed on their right.
    """
    m = change.shape[1]
    for i in range(parts.shape[0]):
        d = parts[i, DEGREE]
        at = parts[i, STORED]
        if parts[i, ROTATION] == 0:
            for j in range(parts[i, DEGREES]):
                for s in range(m):
                    out[at + j, s] = x[at + j] + change[d + j, s]
            continue
        three = parts[i, DEGREES] == 3
        a = x[at]
        b = x[at + 1]
        c = x[at + 2]
        e = x[at + 3]
        for s in range(m):
            tx = change[d, s]
            ty = change[d + 1, s]
            tz = change[d + 2, s] if three else 0.0
            half = 0.5 * math.sqrt(tx * tx + ty * ty + tz * tz)
            k = 0.5 if half == 0.0 else 0.5 * math.sin(half) / half
            w = math.cos(half)
            tx *= k
            ty *= k
            tz *= k
            out[at, s] = a * w - b * tx - c * ty - e * tz
            out[at + 1, s] = a * tx + b * w + c * tz - e * ty
            out[at + 2, s] = a * ty - b * tz + c * w + e * tx
            out[at + 3, s] = a * tz + b * ty - c * tx + e * w


@kernel
def minus(parts, states, x, out):
    """Write the changes (degrees, m) that lead from the state x (size,) to states (size, m)."""
    m = states.shape[1]
    for i in range(parts.shape[0]):
        d = parts[i, DEGREE]
        at = parts[i, STORED]
        if parts[i, ROTATION] == 0:
            for j in range(parts[i, DEGREES]):
                for s in range(m):
                    out[d + j, s] = states[at + j, s] - x[at + j]
            continue
        a = x[at]
        b = -x[at + 1]
        c = -x[at + 2]
        e = -x[at + 3]
        turned = np.empty(3)
        for s in range(m):
            p = states[at, s]
            q = states[at + 1, s]
            r = states[at + 2, s]
            t = states[at + 3, s]
            w = a * p - b * q - c * r - e * t
            turned[0] = a * q + b * p + c * t - e * r
            turned[1] = a * r - b * t + c * p + e * q
            turned[2] = a * t + b * r - c * q + e * p
            length = math.sqrt(turned[0] ** 2 + turned[1] ** 2 + turned[2] ** 2)
            k = 2.0 if length == 0.0 else 2.0 * math.atan2(length, abs(w)) / length
            if w < 0.0:
                k = -k
            for j in range(parts[i, DEGREES]):
                out[d + j, s] = k * turned[j]

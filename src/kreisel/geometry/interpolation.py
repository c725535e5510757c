"""Attitudes and positions between samples, and means over neighbours."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, Indices, conjugate, exp, log, multiply


def slerp(before: Array, after: Array, share: Array | float) -> Array:
    """Return the attitudes a share (…) of the way between attitudes before and after (…, 4), at a steady rate."""
    turned = log(multiply(conjugate(before), after))
    return multiply(before, exp(np.asarray(share)[..., None] * turned))


def interpolate_columns(t: Array, known: Array, values: Array) -> Array:
    """Return values (m, k), known at ascending times (m,), at times t (n,) by straight lines, (n, k)."""
    return np.column_stack([np.interp(t, known, column) for column in values.T])


def nearest(stamps: Array | Indices, moments: Array | Indices) -> Indices:
    """Return the places of the ascending stamps (m,), two or more, that are nearest to moments (n,)."""
    after = np.clip(np.searchsorted(stamps, moments), 1, stamps.size - 1)
    return np.asarray(after - (moments - stamps[after - 1] < stamps[after] - moments))


def continuous(q: Array) -> Array:
    """Return quaternions (n, 4) with signs such that neighbours are close together."""
    sign = np.where(np.einsum("ni,ni->n", q[1:], q[:-1]) < 0.0, -1.0, 1.0)
    return q * np.concatenate([[1.0], np.cumprod(sign)])[:, None]


def running_mean(values: Array, width: int) -> Array:
    """Return means of rows (n, k) over about `width` rows around each; fewer at the ends."""
    n, half = len(values), min(width // 2, len(values))
    sums = np.zeros((n + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=sums[1:])
    out = np.empty(values.shape)
    out[: n - half] = sums[half + 1 :]
    out[n - half :] = sums[n]
    out[half + 1 :] -= sums[1 : n - half]
    number = np.arange(n)
    out /= (np.minimum(number + half + 1, n) - np.maximum(number - half, 0))[:, None]
    return out

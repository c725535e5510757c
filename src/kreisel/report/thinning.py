"""Thinned curves for drawing, with every peak of the full ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kreisel.geometry.rotation import Array, Indices

MAX_POINTS = 1600
"""Points of a curve."""

BUCKETS = 800
"""Intervals of an envelope: as many as a figure has columns."""

_AT_ONCE = 1 << 20  # points of the full curve that are copied together

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Curve:
    """Points of a curve, (n,) each; nan interrupts it."""

    x: Single
    y: Single


@dataclass(frozen=True)
class Envelope:
    """Minimum and maximum value around each x, (n,) each; nan interrupts it."""

    x: Single
    low: Single
    high: Single


def enveloped(x: Array, y: Array, buckets: int = BUCKETS) -> Envelope:
    """Return least and greatest value of buckets of neighbours; x (n,) ascending, interrupted as in `thinned`."""
    width = -(-y.size // buckets)
    starts = np.arange(0, y.size, width)
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    middle = x[np.minimum(starts + width // 2, x.size - 1)]
    # neighbouring buckets touch, so that a steep curve has no gaps
    if width > 1:
        low[:-1], high[:-1] = np.minimum(low[:-1], high[1:]), np.maximum(high[:-1], low[1:])
    jumps = np.flatnonzero(np.diff(middle) > _longest_step(x, starts)) + 1
    x_out, low_out, high_out = (np.insert(part, jumps, np.nan).astype(np.float32) for part in (middle, low, high))
    return Envelope(x_out, low_out, high_out)


def enveloped_axes(x: Array, values: Array) -> tuple[Envelope, ...]:
    """Return the envelopes of all columns of values (n, m)."""
    return tuple(enveloped(x, values[:, i]) for i in range(values.shape[1]))


def thinned(x: Array, y: Array, points: int = MAX_POINTS) -> Curve:
    """Return a curve of at most `points`: least and greatest value of every bucket of neighbours.

    Parameters
    ----------
    x, y : (n,)
        x ascending. Where it jumps by more than a second, and by more than thinning leaves out, the
        curve is interrupted.
    """
    chosen = _extremes(y, points)
    return _interrupted(x[chosen], y[chosen], _longest_step(x, chosen))


def thinned_axes(x: Array, values: Array) -> tuple[Curve, ...]:
    """Return the thinned curves of all columns of values (n, m)."""
    return tuple(thinned(x, values[:, i]) for i in range(values.shape[1]))


def every(count: int, points: int = MAX_POINTS) -> slice:
    """Return the slice that leaves at most `points` of `count` neighbours."""
    return slice(None, None, max(1, -(-count // points)))


def _extremes(y: Array, points: int) -> Indices:
    n = y.size
    if n <= points:
        return np.arange(n)
    width = -(-n // (points // 2))
    together = max(1, _AT_ONCE // width) * width
    both: list[Indices] = []
    for begin in range(0, n, together):
        part = y[begin : begin + together]
        padded = np.concatenate([part, np.full(-part.size % width, part[-1])]).reshape(-1, width)
        first = begin + width * np.arange(len(padded))
        both += [first + padded.argmin(axis=1), first + padded.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(both), n - 1))


def _longest_step(x: Array, chosen: Indices) -> float:
    if x.size < 2:
        return np.inf
    usual = float(np.median(np.diff(x)[every(x.size)]))
    return max(1.0, 3.0 * usual * x.size / max(chosen.size, 1))


def _interrupted(x: Array, y: Array, longest: float) -> Curve:
    jumps = np.flatnonzero(np.diff(x) > longest) + 1
    return Curve(np.insert(x, jumps, np.nan).astype(np.float32), np.insert(y, jumps, np.nan).astype(np.float32))

"""Rates that are too large or too small as a whole, by a wrong unit or sample rate: gravity shows by how much."""

from __future__ import annotations

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, apply, conjugate, exp, lengths, multiply
from kreisel.recording.recording import ImuSamples
from kreisel.static.rests import Rests

_STEP = 0.05
"""s; rates are taken to be constant for as long."""

_SIZES = np.exp(np.linspace(-np.log(80.0), np.log(80.0), 293))
"""Factors on all rates that are compared, 3 % apart: degrees for radians are among them."""

_LEAST, _MOST = np.radians(20.0), 7.0
"""rad: turns of gravity that show a factor, and turns by the gyros, with the factor, that are not too long for it."""

_FEWEST, _WRONG, _RIGHT = 5, 0.4, 0.12
"""Turns that are needed; median angle between gravity as predicted and as measured from which on the rates do not fit,
and up to which they do. Chosen: a device before calibration errs by a few hundredths of its turns."""


def check_rate_size(imu: ImuSamples, rests: Rests) -> None:
    """Refuse rates of which gravity shows that all are wrong by the same factor.

    Raises
    ------
    RecordingError
        With the factor. Rates that fit, or that no factor makes fit, pass.
    """
    up = rests.forces / np.linalg.norm(rests.forces, axis=1, keepdims=True)
    turned = np.arccos(np.clip(np.einsum("mi,mi->m", up[:-1], up[1:]), -1.0, 1.0))
    own = np.flatnonzero(turned > _LEAST)
    if own.size < _FEWEST or not np.ptp(imu.rates, axis=0).all():
        return
    offset = np.median(rests.rates, axis=0)
    angles = [_steps(imu, offset, int(rests.last[m]) - 1, int(rests.first[m + 1])) for m in own]
    length = np.array([lengths(one).sum() for one in angles])

    def typical(sizes: Array) -> Array:
        """Return the median angle by which rates of each size miss gravity; inf where too few turns show it."""
        pairs = zip(angles, own, strict=True)
        misses = np.stack([_misses(one, sizes, up[m], up[m + 1]) for one, m in pairs], axis=1)
        misses[sizes[:, None] * length > _MOST] = np.inf
        seen = [row[np.isfinite(row)] for row in misses]
        return np.array([np.median(row) if row.size >= max(_FEWEST, own.size // 2) else np.inf for row in seen])

    if typical(np.ones(1))[0] <= _WRONG:
        return
    by_size = typical(_SIZES)
    best = int(np.argmin(by_size))
    if by_size[best] < _RIGHT:
        raise RecordingError(
            f"turns agree with gravity only if all rates are multiplied by {_SIZES[best]:.2g}: expected rad/s, and "
            "seconds that are true; check the gyros' unit (0.017: deg/s) and the sample rate",
            file=imu.source,
        )


def _steps(imu: ImuSamples, offset: Array, begin: int, end: int) -> Array:
    """Return the rotation vectors of a turn, step by step, (k, 3)."""
    angle = (imu.rates[begin:end] - offset) * np.diff(imu.seconds[begin : end + 1])[:, None]
    step = max(1, round(_STEP / imu.interval))
    return np.add.reduceat(angle, np.arange(0, len(angle), step), axis=0)


def _misses(angles: Array, sizes: Array, before: Array, after: Array) -> Array:
    """Return the angle between gravity after a turn and as each size of the rates predicts it, (sizes,)."""
    q = np.tile([1.0, 0.0, 0.0, 0.0], (sizes.size, 1))
    for angle in angles:
        q = multiply(q, exp(sizes[:, None] * angle))
    predicted = apply(conjugate(q), np.broadcast_to(before, (sizes.size, 3)))
    return np.asarray(np.arccos(np.clip(predicted @ after, -1.0, 1.0)))

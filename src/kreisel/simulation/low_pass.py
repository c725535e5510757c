"""Devices of limited bandwidth: a low-pass of second order, and readings that are means over an interval."""

from __future__ import annotations

import numpy as np

from kreisel._kernels import recursions
from kreisel.geometry.rotation import Array

FINER = 8
"""Steps of the low-pass in a sampling interval."""

_POLE = np.sqrt(3.0) - 2.0
"""By which the influence of one sample on a cubic spline falls off with every sample between."""

_REACH = 30
"""Samples; 0.27^30 is less than rounding."""


def low_passed(values: Array, rate: float, bandwidth: float) -> Array:
    """Return values (n, 3) after a Butterworth low-pass of second order, in its steady state at the first value.

    Between samples the values are a cubic spline; the low-pass is integrated by the trapezoidal rule, `FINER`
    times finer.
    """
    fine = _refined(values, FINER)
    pole = 2.0 * np.pi * bandwidth
    h = 1.0 / (rate * FINER)
    # x' = A x + B u, of which x_1 is the output; (1 - A h/2) x_k+1 = (1 + A h/2) x_k + B h/2 (u_k + u_k+1)
    A = np.array([[0.0, 1.0], [-(pole**2), -np.sqrt(2.0) * pole]])
    left = np.linalg.inv(np.eye(2) - 0.5 * h * A)
    step, drive = left @ (np.eye(2) + 0.5 * h * A), left @ np.array([0.0, 0.5 * h * pole**2])
    x = np.zeros((2, *fine.shape))
    x[0, 0] = fine[0]
    recursions.drive_oscillators(step, drive, drive.copy(), fine, x)
    return x[0, ::FINER].copy()


def averaged(values: Array) -> Array:
    """Return the means (n, 3) of a cubic spline through the values over the interval before each.

    The first is that of the values.
    """
    bent = _second_differences(values)
    out = values.copy()
    out[1:] = 0.5 * (values[:-1] + values[1:]) - (bent[:-1] + bent[1:]) / 24.0
    return out


def _refined(values: Array, parts: int) -> Array:
    """Return a cubic spline through n values at (n - 1) parts + 1 moments."""
    bent = _second_differences(values)
    s = (np.arange(parts) / parts)[:, None]
    own = (
        (1.0 - s) * values[:-1, None]
        + s * values[1:, None]
        - s * (1.0 - s) * ((2.0 - s) * bent[:-1, None] + (1.0 + s) * bent[1:, None]) / 6.0
    )
    return np.concatenate([own.reshape(-1, values.shape[1]), values[-1:]])


def _second_differences(values: Array) -> Array:
    """Return the second derivatives (n, 3) of a cubic spline through values (n, 3) an interval of 1 apart, n >= 4.

    Notes
    -----
    It has no knot at the second value nor at the last but one.
    M_i-1 + 4 M_i + M_i+1 = 6 d_i with the second differences d. At the ends M_0 - 2 M_1 + M_2 = 0, so M_1 = d_1. The
    solution is d convolved with the inverse of (1, 4, 1) on an endless line, and two terms that fall off from the ends.
    """
    d = np.diff(values, n=2, axis=0)
    inverse = _POLE ** np.abs(np.arange(-_REACH, _REACH + 1)) / (2.0 * np.sqrt(3.0))
    endless = np.column_stack([np.convolve(6.0 * column, inverse)[_REACH:-_REACH] for column in d.T])
    fall = (_POLE ** np.minimum(np.arange(len(d)), 500))[:, None]
    ends = np.array([[1.0, fall[-1, 0]], [fall[-1, 0], 1.0]])
    missing = np.linalg.solve(ends, np.stack([d[0] - endless[0], d[-1] - endless[-1]]))
    inner = endless + fall * missing[0] + fall[::-1] * missing[1]
    return np.concatenate([[2.0 * inner[0] - inner[1]], inner, [2.0 * inner[-1] - inner[-2]]])

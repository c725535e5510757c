"""Where the control points of a motion lie: as close as the motion asks for, and first along the reported poses."""

from __future__ import annotations

import numpy as np

from kreisel.errors import EstimationError
from kreisel.geometry.interpolation import slerp
from kreisel.geometry.pose_spline import ORDER, PoseSpline, centres, count_of
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem

SPACINGS = (0.4, 0.2, 0.1, 0.05, 0.025, 0.0125, 0.00625, 0.003125)
"""Lengths of spans that are tried, s."""

FEWEST = 4
"""Readings in a span, at least."""

MISSED = 0.02
"""What a spline may leave of the readings beyond the finest one, over the variance of their noise. Chosen: parameters
then see a hundredth more noise."""

_LOOK = 60.0
"""Seconds of the readings that are looked at."""


def spacing_of(seconds: Array, rates: Array, forces: Array, deviation: Array) -> float:
    """Return the length of a span that the readings ask for, s.

    seconds (m,), rates and forces (m, 3); deviation (6,): of the white noise of one reading. It is the longest with
    which splines of the readings leave hardly more of them than the shortest possible one: rates have one derivative
    less than the attitude, forces two less than the position.
    """
    interval = float(np.median(np.diff(seconds)))
    possible = [spacing for spacing in SPACINGS if spacing >= FEWEST * interval] or [FEWEST * interval]
    middle = 0.5 * (seconds[0] + seconds[-1])
    own = np.abs(seconds - middle) <= 0.5 * _LOOK
    t = seconds[own]
    left = [
        _left(t, rates[own], spacing, ORDER - 2, deviation[:3])
        + _left(t, forces[own], spacing, ORDER - 3, deviation[3:])
        for spacing in possible
    ]
    return next(
        spacing for spacing, variance in zip(possible, left, strict=True) if variance.max() <= left[-1].max() + MISSED
    )


def _left(t: Array, values: Array, spacing: float, degree: int, deviation: Array) -> Array:
    """Return the variances (3,) that a spline leaves of values, over those of their noise, per degree of freedom."""
    from scipy.interpolate import make_lsq_spline

    count = max(1, int((t[-1] - t[0]) / spacing))
    inner = np.linspace(t[0], t[-1], count + 1)[1:-1]
    filled = np.histogram(t, np.concatenate([[t[0]], inner, [t[-1]]]))[0] > 0
    inner = inner[filled[:-1] & filled[1:]]
    knots = np.concatenate([np.full(degree + 1, t[0]), inner, np.full(degree + 1, t[-1])])
    fitted = make_lsq_spline(t, values, knots, k=degree)
    degrees = max(1, t.size - (knots.size - degree - 1))
    return np.asarray(np.sum((values - fitted(t)) ** 2, axis=0) / degrees / deviation**2)


def first_spline(problem: Problem, known: CellParameters, begin: float, end: float, spacing: float) -> PoseSpline:
    """Return a spline between two times whose control points are reported poses.

    Raises
    ------
    EstimationError
        If the reference has no positions or no orientations.
    """
    reference = problem.reference
    if reference.positions is None or reference.quaternions is None:
        missing = "positions" if reference.positions is None else "orientations"
        raise EstimationError(
            f"the inverse filter needs positions and orientations, and {reference.source} has no {missing}; "
            "choose another estimator"
        )
    at = centres(begin, spacing, count_of(end - begin, spacing))
    tau = np.clip(known.clock.reference_time(at), reference.seconds[0], reference.seconds[-1])
    positions = np.stack([np.interp(tau, reference.seconds, reference.positions[:, i]) for i in range(3)], axis=1)
    k = np.clip(np.searchsorted(reference.seconds, tau, side="right") - 1, 0, reference.seconds.size - 2)
    share = (tau - reference.seconds[k]) / (reference.seconds[k + 1] - reference.seconds[k])
    quaternions = np.array(
        [slerp(reference.quaternions[i], reference.quaternions[i + 1], s) for i, s in zip(k, share, strict=True)]
    )
    signs = np.cumprod(np.where(np.einsum("ki,ki->k", quaternions[1:], quaternions[:-1]) < 0.0, -1.0, 1.0))
    quaternions[1:] *= signs[:, None]
    return PoseSpline(begin, spacing, positions, quaternions)

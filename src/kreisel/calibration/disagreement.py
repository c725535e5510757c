"""Uncertainty of groups that two estimates of one recording disagree about."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.calibration.evidence import Disagreement
from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import PASSING_GROUPS, SENSOR_GROUPS
from kreisel.recording.recording import DataWarning
from kreisel.refinement.estimate import Estimate

MAX_RMS = 2.0
"""Root mean square of a group's scores above which two estimates count as different; by chance, in one case of 200."""


def disagreement(
    found: Estimate, score: Array, factor: Array, added: Callable[[slice, float], float], subject: str, words: str
) -> Disagreement:
    """Return what the sensors' groups of which two estimates differ add to the uncertainty, and what to say of it.

    Parameters
    ----------
    score : (at least the parameters,)
        Difference of the two estimates over its deviation, in the order of the state.
    factor : (degrees, k)
        Of the covariance that a group's further error is a multiple of.
    added
        Returns this multiple for a group's part of the state and the rms of its scores.
    subject, words
        Of the warning; groups, and factors on their deviations, follow.

    Notes
    -----
    The further errors of a group are independent of all else. Its covariances with other groups, such as the robot's
    errors, stay: they are how these act on it.
    """
    layout, variance = found.problem.layout, found.deviation**2
    columns, differing = [], []
    for group in SENSOR_GROUPS:
        if group not in layout or group in PASSING_GROUPS:
            continue
        part = layout[group]
        size = float(np.sqrt(np.mean(score[part] ** 2)))
        if size > MAX_RMS:
            own = np.zeros_like(factor)
            own[part] = np.sqrt(added(part, size)) * factor[part]
            columns.append(own)
            larger = 1.0 + np.sum(own[part] ** 2, axis=1) / variance[part]
            differing.append(f"{group} {float(np.median(larger)) ** 0.5:.1f}")
    if not differing:
        return Disagreement()
    return Disagreement(
        (Contribution(f"disagreement: {subject}", Source.MISFIT, np.hstack(columns)),),
        (DataWarning(subject, f"{words}: {', '.join(differing)}"),),
    )

"""Inflation of the deviations of groups that two estimates of one recording disagree about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kreisel.estimation.belief import with_errors
from kreisel.filtering.estimate import Estimate
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import PASSING_GROUPS, SENSOR_GROUPS
from kreisel.recording.recording import DataWarning

MAX_RMS = 2.0
"""Root mean square of a group's scores above which two estimates count as different; by chance, in one case of 200."""


def with_larger_deviations(
    found: Estimate, score: Array, factor: Callable[[slice, float], float], subject: str, words: str
) -> Estimate:
    """Return the estimate with larger deviations of the sensors' groups that disagree, and a warning that names them.

    Parameters
    ----------
    score : (at least the parameters,)
        Difference of the two estimates over its deviation, in the order of the state.
    factor
        Returns the factor for a group's part of the state and the rms of its scores.
    subject, words
        Of the warning; groups and factors follow.

    Notes
    -----
    An error that is independent of all else is added to each group, so that its deviations grow by the factor. Its
    covariances with other groups, such as the robot's errors, stay: they are how these act on it.
    """
    layout, belief = found.problem.layout, found.run.belief
    columns, told = [], []
    for group in SENSOR_GROUPS:
        if group not in layout or group in PASSING_GROUPS:
            continue
        part = layout[group]
        size = float(np.sqrt(np.mean(score[part] ** 2)))
        if size > MAX_RMS:
            larger = factor(part, size)
            added = np.zeros_like(belief.factor)
            added[part] = np.sqrt(max(larger**2 - 1.0, 0.0)) * belief.factor[part]
            columns.append(added)
            told.append(f"{group} {larger:.1f}")
    if not told:
        return found
    warning = DataWarning(subject, f"{words}: {', '.join(told)}")
    belief = with_errors(belief, np.hstack(columns))
    return replace(found, run=replace(found.run, belief=belief), warnings=(*found.warnings, warning))

"""What innovations say of a model: how much less if they are correlated in time, and how likely they are."""

from __future__ import annotations

import numpy as np

from kreisel.estimation.consistency import correlation_time, gate_bounds, lag_one, mean_normalised
from kreisel.fitting.fit import Fit

COLOURED = 0.3
"""Correlation of neighbouring innovations above which they no longer count as white."""


def correlation_factor(run: Fit) -> float:
    """Return the factor on standard deviations for correlated innovations; 1 where they are white.

    The filter counts an error of the reference that lasts over several updates as a new one at each of them. The
    effective number of updates is theirs divided by the correlation time of the innovations, the larger of those of
    position and orientation. Innovations smaller than assumed reduce the factor.
    """
    history = run.history
    path = history.used & ~history.at_standstill
    size = 1.0
    if path.any():
        size = min(run.excess * mean_normalised(history.nis[path], history.degrees[path]), 1.0)
    times = []
    for rows in (slice(0, 3), slice(3, 6)):
        series = history.whitened[path, rows]
        if series.shape[0] < 20 or not np.isfinite(series).all():
            continue
        if float(np.mean(lag_one(series, np.ones(series.shape[0], dtype=bool)))) > COLOURED:
            times.append(float(np.mean([correlation_time(series[:, i]) for i in range(3)])))
    return float(np.sqrt(max(1.0, size * max(times, default=1.0))))


def bounded_likelihood(run: Fit) -> float:
    """Return the log-likelihood of a run, in which no update counts less than one at the gate.

    Gross errors of a few poses must not decide between models.
    """
    history = run.history
    beyond = np.maximum(history.nis - gate_bounds(history.degrees), 0.0)
    return float(np.sum(history.log_likelihood + 0.5 * beyond))

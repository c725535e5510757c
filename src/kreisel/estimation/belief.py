"""The belief of the rare-update sigma-point Kalman filter, and its changes between updates.

The belief is a mean on the manifold and a lower triangular factor S of the covariance S S^T. A step draws
sigma points once, propagates them with the model to the next update, and combines them there. Prediction
and update are orthogonal triangularisations of arrays whose rows are the state and the measurement, so
the covariance is a sum of squares by construction and cannot become negative.

Parameters do not change between updates: their rows of S stay as they are. The parts that do change
are last in the layout, so only their few rows need triangularising again. The steps themselves are compiled:
`_kernels.filter`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel._kernels import triangular
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Belief:
    """Mean (size,) as stored, and lower triangular factor (degrees, degrees) of the covariance."""

    mean: Array
    factor: Array

    @property
    def covariance(self) -> Array:
        """The covariance (degrees, degrees)."""
        return np.asarray(self.factor @ self.factor.T)

    @property
    def standard_deviation(self) -> Array:
        """Standard deviation of every degree of freedom."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))


def triangularise(columns: Array) -> Array:
    """Return the lower triangular L (n, n) with L L^T = columns columns^T, for columns (n, k)."""
    n, k = columns.shape
    rows = np.zeros((max(n, k), n))
    rows[:k] = columns.T
    triangular.triangularise(rows)
    return rows[:n].T.copy()


def with_errors(belief: Belief, columns: Array) -> Belief:
    """Return the belief with independent errors added, one of unit variance for each of the columns (degrees, k)."""
    return replace(belief, factor=triangularise(np.hstack([belief.factor, columns])))


def inflate_variance(layout: StateLayout, belief: Belief, name: str, deviation: float) -> Belief:
    """Return the belief with the square of a deviation added to a part's variances."""
    upper = belief.factor.T.copy()
    degrees = np.arange(layout[name].start, layout[name].stop)
    triangular.inflate(upper, degrees, np.full(degrees.size, deviation))
    return replace(belief, factor=upper.T.copy())


def renew(layout: StateLayout, belief: Belief, name: str, value: Array, deviation: float) -> Belief:
    """Return the belief with a part of three degrees of freedom replaced by a new value, independent of all others.

    Parameters
    ----------
    value
        The part's stored value.
    deviation
        Its standard deviation in each degree of freedom.
    """
    mean, upper = belief.mean.copy(), belief.factor.T.copy()
    mean[layout.stored(name)] = value
    triangular.renew(upper, layout[name].start, deviation)
    return Belief(mean, upper.T.copy())

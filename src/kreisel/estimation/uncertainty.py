"""The account of an estimate's uncertainty: the estimator's covariance, and what is added to it, each with its cause.

The covariance of an estimator is never changed. What it does not know, such as errors of frames, walks, or halves that
disagree, are contributions: errors of the result that are independent of each other and of the estimator's own. The
total is their sum; it is formed here and nowhere else, and the order of contributions does not matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.errors import EstimationError
from kreisel.estimation.belief import Belief, with_errors
from kreisel.estimation.uncertainty_budget import Source
from kreisel.geometry.rotation import Array


@dataclass(frozen=True)
class Contribution:
    """Independent errors of a result that its estimator does not know.

    Attributes
    ----------
    cause
        What they come from, in words; unique in an account.
    source
        The part of the budget they belong to.
    columns : (degrees, k)
        Their effect on the state, each of unit variance.
    common
        Whether other recordings with the same reference have the same errors.

    Raises
    ------
    EstimationError
        If an effect is not a finite number.
    """

    cause: str
    source: Source
    columns: Array
    common: bool = False

    def __post_init__(self) -> None:
        """Refuse what would be no uncertainty."""
        if not np.isfinite(self.columns).all():
            raise EstimationError(f"the uncertainty by '{self.cause}' is not a finite number; please report this")

    @property
    def variance(self) -> Array:
        """Variance of every degree of freedom (degrees,)."""
        return np.asarray(np.sum(self.columns**2, axis=1))

    @property
    def covariance(self) -> Array:
        """Covariance (degrees, degrees)."""
        return np.asarray(self.columns @ self.columns.T)


def total(belief: Belief, contributions: Iterable[Contribution]) -> Belief:
    """Return an estimator's belief with all contributions."""
    columns = [one.columns for one in contributions]
    return with_errors(belief, np.hstack(columns)) if columns else belief


def scaling(cause: str, source: Source, root: Array, factor: float) -> Contribution:
    """Return the contribution that multiplies deviations by a factor of at least one; root: of their covariance."""
    return Contribution(cause, source, np.sqrt(factor**2 - 1.0) * root)


def along(degrees: int, part: slice, values: Array | Sequence[float]) -> Array:
    """Return the column (degrees, 1) of an error that changes one part of the state, and nothing else."""
    column = np.zeros((degrees, 1))
    column[part, 0] = values
    return column


def each(degrees: int, part: slice, deviation: Array | float) -> Array:
    """Return the columns (degrees, k) of independent errors, one of each degree of freedom of a part."""
    columns = np.zeros((degrees, part.stop - part.start))
    columns[part] = np.diag(np.broadcast_to(deviation, part.stop - part.start))
    return columns

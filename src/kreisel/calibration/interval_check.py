"""Dependence of an estimate on the interval between updates: a sign of errors that are not modelled."""

from __future__ import annotations

import numpy as np

from kreisel.calibration.disagreement import disagreement
from kreisel.calibration.evidence import Disagreement
from kreisel.model.problem import with_rarer_updates
from kreisel.model.schedule import MIN_UPDATES
from kreisel.progress import Progress, of_step
from kreisel.refinement.estimate import Estimate

_MIN = 0.05
"""Minimum variance of a difference, as a share of the estimate's own variance."""


def interval_disagreement(found: Estimate, progress: Progress | None = None) -> Disagreement:
    """Return what groups that an interval twice as long estimates otherwise add to the uncertainty.

    Only where innovations are correlated: something is then left that no effect explains.

    Notes
    -----
    With fewer updates the estimate is less good; the difference then has the difference of the filter's variances as
    its own (Hausman 1978).
    """
    problem, run = found.problem, found.run
    rarer = with_rarer_updates(problem)
    if found.correlation_factor == 1.0 or len(rarer.schedule.updates) < MIN_UPDATES:
        return Disagreement()
    other = found.estimator.refit(rarer, run, progress=of_step(progress, "interval"))
    change = problem.layout.minus(other.belief.mean[:, None], run.belief.mean)[:, 0]
    own = np.sum(found.as_noisy**2, axis=1)
    variance = found.correlation_factor**2 * np.diag(other.belief.covariance) - own
    score = change / np.sqrt(np.maximum(variance, _MIN * own))
    words = (
        "an interval between updates that is twice as long gives other values than expected by chance, which shows "
        "errors of the reference that are not modelled; standard deviations were multiplied"
    )

    def added(part: slice, _size: float) -> float:
        return float(np.mean(change[part] ** 2 / own[part]))

    return disagreement(found, score, found.as_noisy, added, "interval", words)

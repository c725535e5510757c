"""Comparison of the two halves of a recording, each calibrated by itself."""

from __future__ import annotations

from functools import partial

import numpy as np

from kreisel.calibration.disagreement import disagreement
from kreisel.calibration.evidence import Disagreement, SplitHalves
from kreisel.calibration.frame_errors import frame_columns, repeatability_columns
from kreisel.calibration.linear_errors import LINEAR_ERRORS
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import Fit
from kreisel.fitting.partition import nearest_end
from kreisel.fitting.stored_state import first_belief
from kreisel.model.problem import Problem, part_of
from kreisel.model.schedule import MIN_UPDATES
from kreisel.progress import Progress, of_parts, of_step
from kreisel.refinement.estimate import Estimate
from kreisel.tasks import Executor, sequential

_MIN, _MIN_WITH_WALKS = 1e-4, 0.1
"""Minimum variance of a difference, in the sum of both variances."""


def middle_of(problem: Problem) -> int:
    """Return the number of the update with which the second half begins: 0 if halves are too short.

    It is the end of a block, that about half of the motion is before: a device that stands still at first shows nothing
    then that the rest could be compared with.
    """
    rates, updates = problem.sensor.readings.rates, problem.schedule.updates
    way = np.cumsum(np.sum((rates - np.median(rates, axis=0)) ** 2, axis=1))
    moved = way[np.array([update.last for update in updates])]
    half, latest = int(np.searchsorted(moved, 0.5 * moved[-1])), len(updates) - MIN_UPDATES
    return nearest_end(problem, min(max(half, MIN_UPDATES), latest), MIN_UPDATES) if latest >= MIN_UPDATES else 0


def fits_of_halves(
    found: Estimate, progress: Progress | None = None, executor: Executor = sequential
) -> tuple[Fit, Fit] | None:
    """Return the fit of each half of a recording by itself; None if these are too short."""
    problem = found.problem
    middle = middle_of(problem)
    if middle < MIN_UPDATES:
        return None
    of_first, of_second = (of_step(share, "half") for share in of_parts(progress, "halves", 2))
    second = part_of(problem, slice(middle, None))
    a, b = executor(
        [
            partial(found.first, middle, of_first),
            partial(found.estimator.refit, second, found.run, progress=of_second),
        ]
    )
    return a, b


def split_halves(
    found: Estimate, progress: Progress | None = None, executor: Executor = sequential
) -> SplitHalves | None:
    """Return the difference between the estimates of the two halves of a recording; None if these are too short.

    Notes
    -----
    Both halves share the prior, and therefore its error. With covariances A and B of the halves and P of the prior
    and of its error, the difference has the covariance A + B - A P^-1 B - B P^-1 A. Parameters that the prior
    determines, such as errors of a robot that are not observable, are then expected to differ little. The inflation
    of the result for errors that are not estimated is applied here too.
    """
    problem, fits = found.problem, fits_of_halves(found, progress, executor)
    if fits is None:
        return None
    a, b = fits
    n = len(problem.parameter_names)
    difference = problem.layout.minus(b.belief.mean[:, None], a.belief.mean)[:n, 0]
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance)
    A, B, P = (belief.covariance[:n, :n] for belief in (a.belief, b.belief, prior))
    P = P + np.diag(np.where(problem.known_places, problem.walked_variance, 0.0))  # a stated prior may be narrower
    shared = A @ np.linalg.solve(P, B)  # equation (22)
    variance = found.correlation_factor**2 * np.diag(A + B - shared - shared.T)
    # what both share is less certain if offsets walk: the prior is exchanged approximately
    least = _MIN_WITH_WALKS if found.walks else _MIN
    variance = np.maximum(variance, least * np.diag(A + B)) + 0.5 * problem.walked_variance
    variance += np.sum(frame_columns(problem, found.run.parameters)[:n] ** 2, axis=1)
    variance += 4.0 * np.sum(
        repeatability_columns(problem, found.run.parameters)[:n] ** 2, axis=1
    )  # half the standstills each
    plain = np.sqrt(variance)
    # each half errs in its own way: both together as twice their mean
    own = (one for one in found.contributions if one.source is Source.MISFIT or one.cause == LINEAR_ERRORS)
    unlisted = (one.variance[:n] for one in own)
    variance += 4.0 * sum(unlisted, np.zeros(n))
    lasting = problem.lasting
    names = tuple(problem.parameter_names[i] for i in lasting)
    return SplitHalves(names, difference[lasting], np.sqrt(variance[lasting]), plain[lasting])


def halves_disagreement(found: Estimate, halves: SplitHalves | None) -> Disagreement:
    """Return what groups in which the halves disagree add to the uncertainty.

    Scores of a group that are larger than by chance are the effect of a change or an error that is not modelled. The
    result is then as uncertain as the difference of its halves. The estimate is that of what lasts, as the halves are.
    """
    if halves is None:
        return Disagreement()
    words = "the two halves of the recording differ by more than their standard deviations; these were multiplied"
    return disagreement(found, halves.score, found.belief.factor, lambda _, size: size**2 - 1.0, "halves", words)

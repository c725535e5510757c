"""Poses whose stamps are wrong by far more than those of others: innovations along the motion show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.model.assumed_noise import stamps_of
from kreisel.model.problem import Problem
from kreisel.recording.recording import DataWarning

_WRONG, _RIGHT = 3.5, 2.5
"""Deviations of a stamp beyond which it counts as wrong, and within which it does no longer."""

_MOST = 0.25
"""Share of wrong stamps above which it is something else that is wrong."""


def with_wrong_stamps(problem: Problem, run: Fit) -> Problem:
    """Return the problem with stamps that are wrong in a run over it; the very same if they are those known.

    Such a pose says nothing along the motion, and as much as others across it. Only where the gyros show that stamps
    are noisy: else an innovation along the motion has other causes.
    """
    noise, history = problem.noise, run.history
    usual = noise.reference.stamp
    if usual == 0.0:
        return problem
    poses = problem.schedule.poses
    own = noise.stamp_deviations(poses)
    error, deviation = history.late.T
    size = np.abs(error) / np.sqrt(usual**2 + np.maximum(deviation**2 - own**2, 0.0))
    path = ~history.at_standstill
    wrong = path & (size > np.where(own > usual, _RIGHT, _WRONG))
    if not path.any() or float(np.mean(wrong[path])) > _MOST or np.array_equal(wrong, own > usual):
        return problem
    marked = noise.stamp_deviations(np.arange(problem.reference.stamps_ns.size)) > usual
    marked[poses] = wrong
    return replace(problem, noise=replace(noise, stamps=stamps_of(usual, marked, problem.reference.interval)))


def wrong_stamps_warning(problem: Problem) -> list[DataWarning]:
    """Return the warning that some of the poses that are used have wrong stamps."""
    noise = problem.noise
    count = int(np.sum(noise.stamp_deviations(problem.schedule.poses) > noise.reference.stamp))
    if count == 0:
        return []
    message = (
        f"{count} of the poses used have stamps that are wrong by far more than others; they count across the motion"
    )
    return [DataWarning("stamps", message)]

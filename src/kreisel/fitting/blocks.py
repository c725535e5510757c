"""What parts of a recording say about the parameters, each by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.model.problem import Problem

MIN_BLOCK_SECONDS = 4.0
"""s; shortest block, longer than errors of a reference on its path are correlated."""

MAX_BLOCKS = 120
"""Number of blocks at most: of more, each says little, and each costs an inverse."""

MIN_BLOCKS = 8
"""Number of blocks from which their scatter says something."""


@dataclass(frozen=True)
class Blocks:
    """What blocks of updates say about constant parameters; navigation and all that changes are eliminated.

    Under the model scores are independent of each other and of mean zero at the true parameters, and each has its
    information as covariance.

    Attributes
    ----------
    parameters : (n,)
        Degrees of freedom of the state that are constant: `Problem.constant`.
    ends : (B,)
        Number of the update before which each block ends.
    information : (B, n, n)
        Information matrix that a block adds to those before it.
    score : (B, n)
        Gradient of its log-likelihood at the fit. A Newton step from the fit by a block alone is information^-1 score.
    """

    parameters: Indices
    ends: Indices
    information: Array
    score: Array

    def about(self, step: Array) -> Blocks:
        """Return the blocks linearised about another fit, a step (degrees,) of the state away."""
        return replace(self, score=self.score - self.information @ step[self.parameters])


def increments(parameters: Indices, ends: Indices, distance: Array, covariance: Array) -> Blocks:
    """Return the blocks between moments at which estimate and covariance of the parameters are known.

    Parameters
    ----------
    parameters : (n,)
        Their places in the state.
    ends : (B,)
        Of the blocks.
    distance : (B + 1, n)
        Of the estimate from the fit, before the first block and after each.
    covariance : (B + 1, n, n)
        Of the parameters then, all else eliminated.
    """
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[-1])
    scaled = covariance / np.outer(size, size)
    information = np.linalg.inv(0.5 * (scaled + np.swapaxes(scaled, 1, 2))) / np.outer(size, size)
    gradient = np.einsum("bij,bj->bi", information, distance)
    return Blocks(parameters, ends, np.diff(information, axis=0), np.diff(gradient, axis=0))


def block_ends(problem: Problem) -> list[int]:
    """Return where blocks end: at the beginning of standstills where there are some, else by time."""
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    times = stamps[np.array([update.last for update in updates])]
    shortest = max(MIN_BLOCK_SECONDS, float(times[-1] - times[0]) / MAX_BLOCKS)
    resting = standstills_in(problem) >= MIN_BLOCKS
    ends, begun = [], float(times[0])
    for i, update in enumerate(updates[1:], start=1):
        fitting = update.new_standstill if resting else True
        if (fitting and times[i] - begun >= shortest) or times[i] - begun >= 3.0 * shortest:
            ends.append(i + 1)
            begun = float(times[i])
    if ends and len(updates) - ends[-1] < 3:
        ends.pop()
    return [*(end for end in ends if end < len(updates)), len(updates)]


def standstills_in(problem: Problem) -> int:
    """Return the number of standstills."""
    return sum(update.new_standstill for update in problem.schedule.updates)

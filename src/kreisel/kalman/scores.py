"""Scores of terms outside the state, by adjoint: how the likelihood of a run changes, for any number of terms at once.

One recursion back over the slopes of a run gives the derivative of the log-likelihood by every reading, every pose and
every increment of a parameter. Scores of thousands of terms, and of random walks, are sums of these. The same recursion
over innovations that are drawn as the model says gives what the scores would be by chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel._kernels.slope_recursions import carry_back, carry_innovations
from kreisel.fitting.terms import ACCEL_ROWS, POSE_ROWS, Scores, Terms
from kreisel.geometry.rotation import Array, Indices
from kreisel.kalman.elimination import Elimination
from kreisel.kalman.run_slopes import Slopes, offsets
from kreisel.model.problem import Problem

DRAWS = 32
"""Draws by which the size of a score by chance is known: to an eighth."""

_SEED = 5
"""Of the draws: the same recording gives the same result."""


@dataclass(frozen=True)
class Gradients:
    """Derivatives of log-likelihoods, all parameters estimated: of the data, then of draws, (…, 1 + r).

    Attributes
    ----------
    readings : (u, 6, 1 + r)
        By a constant that is added to the readings since the update before.
    position : (u, 3, 1 + r)
        By a shift of the position then.
    poses : (u, 6, 1 + r)
        By a change of the true pose against the reported.
    increments : (u, n, 1 + r)
        By a lasting change of a parameter before the update, for the first n degrees of freedom.
    """

    readings: Array
    position: Array
    poses: Array
    increments: Array


def gradients(problem: Problem, slopes: Slopes, known: Elimination, walking: Indices) -> Gradients:
    """Return the derivatives of the log-likelihoods of a run and of draws.

    walking (n,): degrees of freedom whose increments are wanted.
    """
    rng = np.random.default_rng(_SEED)
    measured, n = np.concatenate([s.counted for s in slopes.stretches()]), known.scale.size
    noise = rng.standard_normal((slopes.count, 9, DRAWS)) * measured[:, :, None]
    moved = _estimates(slopes, noise)[:n]
    own = known.step(known.to_begun, known.to_prior)[:, None]
    by_chance = known.drawn(-moved / known.scale[:, None], rng)
    end = np.zeros((slopes.degrees, 1 + DRAWS))
    end[:n] = known.run @ np.hstack([own, by_chance]) / known.scale[:, None]
    return _back(problem, slopes, noise, end, walking)


def _estimates(slopes: Slopes, noise: Array) -> Array:
    """Return what whitened innovations (u, 9, r) make of the last estimate, (n, r)."""
    state = np.zeros((slopes.degrees, noise.shape[2]))
    for stretch in slopes.stretches():
        carry_innovations(stretch.tables, noise[stretch.numbers], state)
    return state


def _back(problem: Problem, slopes: Slopes, noise: Array, end: Array, walking: Indices) -> Gradients:
    rows, places = offsets(problem)
    u, columns = slopes.count, end.shape[1]
    found = Gradients(
        np.zeros((u, 6, columns)), np.zeros((u, 3, columns)), np.zeros((u, 6, columns)),
        np.zeros((u, walking.size, columns)),
    )  # fmt: skip
    position = slopes.position + np.arange(3)
    first, second = np.concatenate([position, places]), np.concatenate([places, walking])
    for stretch in reversed([*slopes.stretches()]):
        own, W = stretch.numbers, stretch.whitening.swapaxes(1, 2)
        weights = np.concatenate([stretch.innovations[:, :, None], noise[own]], axis=2)  # equation (30)
        after, before = carry_back(stretch.tables, weights, end, after=first, before=second)
        found.position[own] = after[:, :3] + W[:, :3] @ weights
        found.poses[own] = -(W[:, : len(POSE_ROWS)] @ weights)
        # an offset stays after the update, what is added to its readings does not
        found.readings[own, rows] = before[:, : places.size] - after[:, 3:]
        found.increments[own] = before[:, places.size :]
    return found


def scores_of(found: Gradients, terms: Terms) -> Scores:
    """Return the scores of terms."""
    count = terms.count
    out = np.zeros((count, found.readings.shape[2]))
    for row in np.unique(terms.row):
        own = np.flatnonzero(terms.row == row)
        functions = terms.functions[:, terms.function[own]]
        if row < POSE_ROWS.start:
            out[own] = functions.T @ found.readings[:, row]
        else:
            direction = terms.directions[:, :, row - POSE_ROWS.start]
            out[own] = functions.T @ np.einsum("ui,uic->uc", direction, found.poses)
        if terms.moments is not None and row in ACCEL_ROWS:
            along = np.einsum("ui,uic->uc", terms.axes[:, :, row - ACCEL_ROWS.start], found.position)
            out[own] += terms.moments[:, terms.function[own]].T @ along
    return Scores(out[:, 0], out[:, 1:].T)


def walk_score(found: Gradients, places: Indices, seconds: Array) -> Scores:
    """Return the score of the variance of a random walk of some of the increments' degrees of freedom.

    The derivative of the log-likelihood by it, but for a factor and a constant that draws have too.
    """
    value = np.einsum("uic,uic,u->c", found.increments[:, places], found.increments[:, places], seconds)
    return Scores(value[:1], value[1:, None])

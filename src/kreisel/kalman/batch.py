"""The most likely state of all updates at once: Gauss and Newton's method over the whole recording.

With the models linearised about the states found last, the next ones follow by elimination, update by update, from the
first to the last: that is a Kalman filter. A recursion back gives them all. What changes between updates is eliminated
before the parameters, so that the cost is proportional to the number of updates, and the covariance of all parameters
is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel._kernels.slope_recursions import carry_back
from kreisel.estimation.belief import Belief
from kreisel.estimation.sigma_points import DERIVATIVES
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.fit import WIDE_GATE, Fit
from kreisel.fitting.nonlinearity import curved
from kreisel.fitting.partition import block_ends
from kreisel.fitting.stored_state import first_belief, stored_state
from kreisel.geometry.rotation import Array, Indices, exp, multiply
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.linear_run import LinearRun, blocks_of
from kreisel.kalman.prior_exchange import elimination, narrowed_belief, start_near, with_stated_prior
from kreisel.kalman.run_slopes import Slopes
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress

SETTLED = 0.05
"""Change of every parameter that is expected of a further iteration, in standard deviations, below which there is none.
Chosen: far below what errors of the model do."""

NEARLY_SETTLED = 1.0
"""Change that is expected of the next iteration, in standard deviations, up to which it is likely to be the last."""

MAX_ITERATIONS = 12
"""Largest number of iterations. Chosen: first errors of 10 deg take four to six."""


@dataclass(frozen=True)
class Batch:
    """Maximum a posteriori of the whole recording; see `fitting.fit.Estimator`."""

    name: str = "batch"
    points: str = DERIVATIVES

    def fit(self, problem: Problem, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from its start values."""
        start = problem.prior.start
        return _iterated(problem, start, first_belief(problem, start), _about(problem, start, None), gate, progress)

    def refit(self, problem: Problem, near: Fit, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from the result of another one."""
        start, begun = start_near(problem, near), narrowed_belief(problem, near)
        return _iterated(problem, start, begun, _about(problem, start, near), gate, progress)

    def repeat(self, problem: Problem, fit: Fit, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem linearised about the states that another one was linearised about."""
        return _run(problem, fit.start, fit.begun, fit.about, fit.gate, progress)

    def blocks(self, problem: Problem, near: Fit, ends: Sequence[int], progress: StepProgress | None = None) -> Blocks:
        """Return what each block of updates says about the parameters: the increments of one iteration."""
        start, begun = start_near(problem, near), narrowed_belief(problem, near)
        found: list[Belief] = [begun]
        about = _about(problem, start, near)
        _run(problem, start, begun, about, near.gate, progress, dict.fromkeys(ends, found.append))
        return blocks_of(problem, near, np.asarray(ends), found)

    def linearise(self, problem: Problem, near: Fit, progress: StepProgress | None = None) -> LinearRun:
        """Return a linearisation of a problem about a fit: the slopes of one iteration."""
        start, begun, slopes = start_near(problem, near), narrowed_belief(problem, near), Slopes(problem)
        about, ends, found = _about(problem, start, near), block_ends(problem), [begun]
        run = _run(problem, start, begun, about, WIDE_GATE, progress, dict.fromkeys(ends, found.append), slopes)
        fit, known = with_stated_prior(problem, run, begun), elimination(problem, run, begun)
        return LinearRun(problem, near, run, fit, known, slopes, np.asarray(ends), found, with_stated_prior)

    def navigate(self, problem: Problem, known: CellParameters, progress: StepProgress | None = None) -> Fit:
        """Return the innovations of navigation with known parameters; none is rejected."""
        return run_filter(problem, known, gate=np.inf, progress=progress, points=DERIVATIVES)


def _iterated(
    problem: Problem, start: CellParameters, begun: Belief, about: Array, gate: float, progress: StepProgress | None
) -> Fit:
    """Return the fit of a problem, linearised again and again about what was found last.

    What changes between updates is smoothed after an iteration only if there is likely to be a further one: near a fit
    not after the first, and not where the last is expected. Iterations end when the next one is expected to move
    nothing: by as much less than the last as that moved less than the one before, unless the model was curved there.
    """
    changing, smooth, before = varying(problem), about.shape[1] != problem.layout.size, 0.0
    for _ in range(MAX_ITERATIONS):
        slopes = Slopes(problem, changing) if smooth else None
        run = _run(problem, start, begun, about, gate, progress, slopes=slopes)
        fit = with_stated_prior(problem, run, begun)
        moved = problem.layout.minus(fit.belief.mean[:, None], begun.mean)[problem.lasting, 0]
        largest = float(np.max(np.abs(moved) / fit.belief.standard_deviation[problem.lasting], initial=0.0))
        expected = largest * min(1.0, largest / before) if before > 0.0 else largest
        if about.shape[1] == problem.layout.size and expected < SETTLED:
            break
        start, begun = start_near(problem, fit), narrowed_belief(problem, fit)
        about = _with_parameters(problem, about, start) if slopes is None else smoothed(problem, run, slopes)
        smooth = slopes is None or (before > 0.0 and expected > NEARLY_SETTLED)
        before = 0.0 if curved(problem, fit) else largest
    return fit


def _about(problem: Problem, start: CellParameters, near: Fit | None) -> Array:
    """Return the states that a problem is linearised about first: (u, size) as in a fit near it, or the parameters.

    Those of the fit are used if they are of the same state at the same times.
    """
    updates, size = problem.schedule.updates, problem.layout.size
    if near is not None and near.about is not None and near.about.shape == (len(updates), size):
        seconds = problem.sensor.readings.stamps[[update.last for update in updates]]
        if np.array_equal(near.history.seconds, seconds):
            return _with_parameters(problem, near.about, start)
    return np.tile(stored_state(problem, start)[: _stored_parameters(problem)], (len(updates), 1))


def _with_parameters(problem: Problem, about: Array, start: CellParameters) -> Array:
    """Return states (u, a) with other values of the parameters that are the same at all updates."""
    layout, state, out = problem.layout, stored_state(problem, start), about.copy()
    whole = about.shape[1] == layout.size
    for group in problem.groups:
        if not whole or not _varies(problem, group):
            out[:, layout.stored(group)] = state[layout.stored(group)]
    return out


def _stored_parameters(problem: Problem) -> int:
    """Return how many numbers the parameters have in the stored state, at its beginning."""
    return max((problem.layout.stored(group).stop for group in problem.groups), default=0)


def varying(problem: Problem) -> Indices:
    """Return the degrees of freedom that are not the same at all updates."""
    layout = problem.layout
    parts = [layout[part.name] for part in layout if _varies(problem, part.name)]
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def _varies(problem: Problem, name: str) -> bool:
    """Return whether a part of the state is not the same at all updates."""
    noise = problem.noise
    return name not in problem.groups or name in noise.gauss_markov or noise.offset_walk.get(name, 0.0) > 0.0


def _run(
    problem: Problem, start: CellParameters, begun: Belief | None, about: Array | None, gate: float,
    progress: StepProgress | None, visit: Mapping[int, Callable[[Belief], None]] | None = None,
    slopes: Slopes | None = None,
) -> Fit:  # fmt: skip
    """Return the result of one elimination of a problem that is linearised about some states."""
    return run_filter(
        problem, start, belief=begun, gate=gate, progress=progress, visit=visit, slopes=slopes,
        points=DERIVATIVES, about=about,
    )  # fmt: skip


def path_near(problem: Problem, near: Fit, progress: StepProgress | None = None) -> Array:
    """Return the most likely states before all updates, (u, size), of a problem linearised about a fit."""
    start, begun = start_near(problem, near), narrowed_belief(problem, near)
    slopes = Slopes(problem, varying(problem))
    run = _run(problem, start, begun, _about(problem, start, near), near.gate, progress, slopes=slopes)
    return smoothed(problem, run, slopes)


def smoothed(problem: Problem, run: Fit, slopes: Slopes) -> Array:
    """Return the most likely states before all updates, (u, size), of a linearised run.

    Notes
    -----
    The modified Bryson-Frazier smoother (Bierman 1973): the derivative of the log-likelihood of all that follows by the
    state before an update, times its covariance, is what that adds to its mean.
    """
    layout, changing = problem.layout, slopes.varying
    means, changes = np.empty((slopes.count, layout.size)), np.zeros((slopes.count, layout.degrees))
    state, every, none = np.zeros((layout.degrees, 1)), np.arange(layout.degrees), np.zeros(0, dtype=np.int64)
    for stretch in reversed([*slopes.stretches()]):
        own, weights = stretch.numbers, stretch.innovations[:, :, None].copy()
        _, before = carry_back(stretch.tables, weights, state, after=none, before=every)
        means[own] = stretch.mean
        changes[own, changing] = (stretch.covariance @ before)[:, :, 0]  # equation (31)
    out = np.tile(run.belief.mean, (slopes.count, 1))
    for part in layout:
        if _varies(problem, part.name):
            own, change = layout.stored(part.name), changes[:, layout[part.name]]
            out[:, own] = multiply(means[:, own], exp(change)) if part.rotation else means[:, own] + change
    return out

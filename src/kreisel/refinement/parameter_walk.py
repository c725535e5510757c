"""Random walks of offsets and of the clocks, with a density found by likelihood.

An offset that warms up, steps or walks, and a clock that jumps or drifts, all leave innovations that a parameter with
a random walk explains: the filter then forgets what it learnt of it long ago.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.fitting.fit import Estimator, Fit, Linearised
from kreisel.model.parameters import WALKING_GROUPS
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress
from kreisel.refinement.correlated_innovations import bounded_likelihood
from kreisel.tasks import Executor, sequential

_FIRST, _STEP, _MAX_STEPS = 3.0, 3.0, 12
"""Standard deviations that the first walk covers over the whole run; factor from one to the next; largest number."""


_WORTH = 2.0
"""Deviations of a walk's score from its mean by chance, beyond which it is tried."""


def may_walk(problem: Problem, linear: Linearised) -> bool:
    """Return whether the score of a random walk is larger than by chance: only then it is worth a pass to try."""
    for group in WALKING_GROUPS:
        if group in problem.layout:
            score = linear.walk_score(group)
            size = float(np.std(score.draws))
            if float(score.value[0]) > float(np.mean(score.draws)) + _WORTH * size:
                return True
    return False


def found_walks(
    problem: Problem, run: Fit, estimator: Estimator, least: float, progress: StepProgress | None = None,
    executor: Executor = sequential,
) -> tuple[Problem, dict[str, float]] | None:  # fmt: skip
    """Return the problem with the walks that raise the likelihood of its run most, and what each gains.

    None if that is below `least`.

    All are tried together first; only if that gains, each by itself, and with growing density as long as it gains.
    Where tasks run at the same time, the next larger density is tried beside one.
    """
    groups = [g for g in WALKING_GROUPS if g in problem.layout]
    if not groups:
        return None
    seconds = float(problem.sensor.readings.stamps[problem.schedule.updates[-1].last])
    deviation = run.belief.standard_deviation
    min_densities = {g: _FIRST * float(np.median(deviation[problem.layout[g]])) * seconds**-0.5 for g in groups}

    def likelihood(walks: dict[str, float]) -> float:
        own = {g: max(walks.get(g, 0.0), density) for g, density in (problem.noise.offset_walk | walks).items()}
        return bounded_likelihood(estimator.repeat(with_walks(problem, own), run, progress))

    base = bounded_likelihood(run)
    if likelihood(min_densities) < base + least:
        return None
    walks: dict[str, float] = {}
    gains: dict[str, float] = {}
    best = base
    together = 1 if executor is sequential else 2
    for group in groups:
        density = max(min_densities[group], problem.noise.offset_walk.get(group, 0.0))
        larger = density * _STEP ** np.arange(_MAX_STEPS)
        for k in range(0, _MAX_STEPS, together):
            tried = larger[k : k + together]
            for one, now in zip(
                tried, executor([partial(likelihood, walks | {group: one}) for one in tried]), strict=True
            ):
                if growing := now >= best + (least if group not in walks else 0.0):
                    gains[group] = gains.get(group, 0.0) + now - best
                    walks[group], best = float(one), now
                else:
                    break
            if not growing:
                break
    if best < base + least or not walks:
        return None
    return with_walks(problem, problem.noise.offset_walk | walks), gains


def with_walks(problem: Problem, density: dict[str, float]) -> Problem:
    """Return the problem with random walks of groups, their densities in SI per root second."""
    return replace(problem, noise=replace(problem.noise, offset_walk=density))

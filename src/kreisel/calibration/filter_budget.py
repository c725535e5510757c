"""The budget of uncertainty: how much of each parameter's variance comes from which source.

The contributions of an account are known. The filter's own variance is split too: it is a homogeneous function, of
first degree, of the variances of all noise and of the prior, so that it equals the sum of these times their
derivatives (Euler). For an optimal gain a derivative is what a source adds to the variance with the gain as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array
from kreisel.model.assumed_noise import AssumedNoise
from kreisel.model.groups import group_named
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.model.problem import Problem
from kreisel.progress import Progress, of_parts, of_step
from kreisel.refinement.estimate import Estimate
from kreisel.tasks import Executor, sequential

_STEP = 0.1
"""Relative step of a variance for its derivative: the variance is nearly a straight line over it."""

_CLOCKS = ("time_offset", "time_skew")


def budget_of(found: Estimate, parts: Mapping[Source, Array]) -> Budget:
    """Return the budget of an estimate's parameters.

    Parameters
    ----------
    parts
        Shares of the filter's own variance, (n,) each; see `filter_parts`.
    """
    names = found.problem.parameter_names
    n = len(names)
    own = found.run.belief.standard_deviation[:n] ** 2
    rows = [(str(source), source, share * own) for source, share in parts.items()]
    rows += [(one.cause, one.source, one.variance[:n]) for one in found.contributions]
    variance = np.column_stack([values for _, _, values in rows])
    return Budget.of(names, {cause: source for cause, source, _ in rows}, variance)


def filter_parts(
    found: Estimate, progress: Progress | None = None, executor: Executor = sequential
) -> dict[Source, Array]:
    """Return the share of each source in the filter's variance of every lasting parameter; their sum is one.

    The reference's noise by differences of passes, the prior exactly; what is left is the sensors' noise.
    """
    problem, n = found.problem, len(found.problem.parameter_names)
    larger = _with_more(problem.noise)
    problems = [problem, *(replace(problem, noise=noise) for noise in larger.values())]
    base, *others = executor([
        partial(found.estimator.refit, one, found.run, gate=np.inf, progress=of_step(step, "budget"))
        for one, step in zip(problems, of_parts(progress, "budget", len(problems)), strict=True)
    ])  # fmt: skip
    whole = base.belief.standard_deviation[:n] ** 2
    parts = {
        source: variance / whole for source, variance in _of_prior(problem, base.belief.covariance[:n, :n]).items()
    }
    for source, other in zip(larger, others, strict=True):
        change = (other.belief.standard_deviation[:n] ** 2 - whole) / (_STEP * whole)
        parts[source] = parts.get(source, 0.0) + np.maximum(change, 0.0)
    known = np.sum(list(parts.values()), axis=0)
    parts[Source.SENSOR] = np.maximum(1.0 - known, 0.0)
    lasting = problem.lasting
    return {source: (parts[source] / np.maximum(known, 1.0))[lasting] for source in Source if source in parts}


def _with_more(noise: AssumedNoise) -> dict[Source, AssumedNoise]:
    """Return the noise with variances of one source that are larger by a step, for each source."""
    factor = (1.0 + _STEP) ** 0.5
    own, reference = noise.pose_error, noise.reference
    path = replace(
        reference.scaled(position=factor, orientation=factor, standstill=1.0), stamp=factor * reference.stamp
    )
    still = reference.scaled(position=1.0, orientation=1.0, standstill=factor)
    out = {Source.PATH: replace(noise, reference=path), Source.STANDSTILL: replace(noise, reference=still)}
    if own.time > 0.0:
        geometry = replace(own, position=factor * own.position, orientation=factor * own.orientation)
        out[Source.ROBOT] = replace(noise, pose_error=geometry)
    return out


def _of_prior(problem: Problem, P: Array) -> dict[Source, Array]:
    """Return what priors add to the variances of all parameters (n,), by source, from their covariance (n, n).

    That of groups that change within seconds is for noise: it is left to what is left.
    """
    layout, n = problem.layout, len(P)
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance).covariance[:n, :n]
    information = np.linalg.inv(prior + np.diag(problem.walked_variance))
    out: dict[Source, Array] = {}
    for group in problem.groups:
        if group in PASSING_GROUPS:
            continue
        d = layout[group]
        if group in _CLOCKS:
            source = Source.CLOCKS
        else:
            source = Source.ROBOT if group_named(group).owner in ("robot", "reference") else Source.PRIOR
        variance = np.einsum("ij,jk,ik->i", P[:, d], information[d, d], P[:, d])
        out[source] = out.get(source, np.zeros(n)) + variance
    return out

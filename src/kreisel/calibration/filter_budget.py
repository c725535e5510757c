"""The budget of uncertainty: how much of each parameter's variance comes from which source.

The contributions of an account are known. The filter's own variance is split too: its error is a sum of the errors of
all measurements and of the prior, each times a derivative that the gain decides.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.estimation.uncertainty_budget import Budget, Source
from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array
from kreisel.model.groups import group_named
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.model.problem import Problem
from kreisel.progress import Progress, of_step
from kreisel.refinement.estimate import Estimate

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


def filter_parts(found: Estimate, progress: Progress | None = None) -> dict[Source, Array]:
    """Return the share of each source in the filter's variance of every lasting parameter; their sum is one.

    What is neither the reference's noise nor the prior's is the sensors' noise.
    """
    problem, n = found.problem, len(found.problem.parameter_names)
    linear = found.linear or found.estimator.linearise(problem, found.run, of_step(progress, "budget"))
    P = linear.fit.belief.covariance[:n, :n]
    parts = _of_prior(problem, P)
    for source, variance in linear.variance_of_reference().items():
        parts[source] = parts.get(source, np.zeros(n)) + variance
    parts = {source: variance / np.diag(P) for source, variance in parts.items() if variance.any()}
    known = np.sum(list(parts.values()), axis=0)
    parts[Source.SENSOR] = np.maximum(1.0 - known, 0.0)
    lasting = problem.lasting
    return {source: (parts[source] / np.maximum(known, 1.0))[lasting] for source in Source if source in parts}


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

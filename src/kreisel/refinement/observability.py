"""Which parameters are observable with this motion, by the decrease of their deviation below the prior's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.model.groups import REGISTRY
from kreisel.model.problem import Problem

MAX_SHARE = 0.5
"""A parameter whose standard deviation is still above this share of the prior's is not observable."""


@dataclass(frozen=True)
class Observability:
    """Observability of every parameter.

    Attributes
    ----------
    names
        Of the estimated parameters, one for each degree of freedom.
    prior, posterior : (n,)
        Standard deviations.
    unobservable
        Names of those that are not observable, or too weakly to be of use.
    not_narrowed
        Those of them whose standard deviation hardly decreased.
    """

    names: tuple[str, ...]
    prior: Array
    posterior: Array
    unobservable: tuple[str, ...]
    not_narrowed: tuple[str, ...]


def observability(problem: Problem, deviation: Array) -> Observability:
    """Return the observability of each parameter, by the standard deviations of an estimate (degrees,)."""
    names: list[str] = []
    prior: list[float] = []
    posterior: list[float] = []
    unobservable: list[str] = []
    not_narrowed: list[str] = []
    stated = {name for name, _, _ in problem.settings.priors}
    own = problem.parameter_names
    for known in REGISTRY:
        group = known.name
        if group not in problem.layout:
            continue
        d = problem.layout[group]
        width = np.resize(problem.prior.width[group], d.stop - d.start)
        for name, before, after in zip(own[d], width, deviation[d], strict=True):
            names.append(name)
            prior.append(float(before))
            posterior.append(float(after))
            lost = after > MAX_SHARE * before
            if known.known_before or group in problem.prior.stated or name in stated:
                lost = False
            if lost:
                not_narrowed.append(name)
            if lost or after > known.useful_sd:
                unobservable.append(name)
    return Observability(tuple(names), np.array(prior), np.array(posterior), tuple(unobservable), tuple(not_narrowed))

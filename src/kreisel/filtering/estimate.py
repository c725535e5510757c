"""The estimate after all passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kreisel.estimation.belief import Belief, triangularise
from kreisel.filtering.history import FilterRun
from kreisel.geometry.rotation import Array
from kreisel.model.considered import Considered
from kreisel.model.layout import without
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.model.problem import Problem, with_nominal
from kreisel.recording.recording import DataWarning


@dataclass(frozen=True)
class Estimate:
    """Final problem (with the noise finally assumed), the run over it, and the warnings about both.

    The belief's factor is already multiplied by `correlation_factor`. `contradiction` is the largest factor
    by which given noise figures had to be raised; 1 if none were given or none had to be raised. `moved` is the
    largest change of a parameter by the last pass, in standard deviations; 0 if one pass was enough. `considered` are
    all effects beyond the usual ones, found or not; `walks` the groups that walk, and what that gains in
    log-likelihood; `contradicted` the offsets whose stated prior had to be widened, with their scores; `stated` the
    problem as it was stated. `common` are columns of the belief's covariance, (degrees, k): errors of unit variance
    that other recordings of the same robot share. `filtered` is the belief before deviations were made larger: the
    information of the data and of the prior.
    """

    problem: Problem
    run: FilterRun
    passes: int
    correlation_factor: float
    contradiction: float
    moved: float
    warnings: tuple[DataWarning, ...]
    considered: tuple[Considered, ...] = ()
    walks: Mapping[str, float] = field(default_factory=dict)
    contradicted: Mapping[str, float] = field(default_factory=dict)
    stated: Problem | None = None
    common: Array = field(default_factory=lambda: np.zeros((0, 0)))
    filtered: Belief | None = None


def without_passing(found: Estimate) -> Estimate:
    """Return the estimate of what lasts: the marginal distribution without groups that change within seconds."""
    problem, run = found.problem, found.run
    layout, lasting = problem.layout, problem.lasting
    if lasting.size == len(problem.parameter_names):
        return found
    smaller = without(layout, PASSING_GROUPS)
    kept = np.concatenate([np.r_[layout[part.name]] for part in smaller])
    stored = np.concatenate([np.r_[layout.stored(part.name)] for part in smaller])
    history, filtered = run.history, found.filtered
    if filtered is not None:
        filtered = Belief(filtered.mean[stored], triangularise(filtered.factor[kept]))
    return replace(
        found,
        problem=replace(problem, layout=smaller),
        common=found.common[kept] if found.common.size else found.common,
        filtered=filtered,
        run=replace(
            run,
            belief=Belief(run.belief.mean[stored], triangularise(run.belief.factor[kept])),
            parameters=with_nominal(problem, run.parameters, PASSING_GROUPS),
            history=replace(
                history, parameters=history.parameters[:, lasting], deviations=history.deviations[:, lasting]
            ),
        ),
    )

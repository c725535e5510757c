"""The estimate after all passes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kreisel.estimation.belief import Belief, triangularise
from kreisel.estimation.uncertainty import Contribution, total
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.fit import Estimator, Fit, Linearised
from kreisel.geometry.rotation import Array
from kreisel.model.considered_terms import Considered
from kreisel.model.layout import without
from kreisel.model.parameters import PASSING_GROUPS
from kreisel.model.problem import Problem, part_of, with_nominal, with_readings
from kreisel.progress import StepProgress
from kreisel.recording.recording import DataWarning
from kreisel.refinement.discrepancy_terms import FoundFamily


@dataclass(frozen=True)
class Estimate:
    """Final problem (with the noise finally assumed), the run over it, and the warnings about both.

    `run` is the last fit of the `estimator`; its belief is the information of data and prior. `contributions` are what
    it does not know; `belief` is the total. `correlation_factor` is what correlated innovations multiply the fit's
    deviations by. `contradiction` is the largest factor by which given noise figures had to be raised; 1 if none were
    given or none had to be raised. `moved` is the largest change of a parameter by the last pass, in standard
    deviations; 0 if one pass was enough. `considered` are all effects beyond the usual ones, found or not; `walks` the
    groups that walk, and what that gains in log-likelihood; `contradicted` the offsets whose stated prior had to be
    widened, with their scores; `stated` the problem as it was stated; `discrepancy` the families of generic terms by
    which its readings and poses are corrected; `linear` the problem linearised near the run, if that is known already.
    """

    problem: Problem
    run: Fit
    estimator: Estimator
    passes: int
    correlation_factor: float
    contradiction: float
    moved: float
    warnings: tuple[DataWarning, ...]
    considered: tuple[Considered, ...] = ()
    walks: Mapping[str, float] = field(default_factory=dict)
    contradicted: Mapping[str, float] = field(default_factory=dict)
    stated: Problem | None = None
    contributions: tuple[Contribution, ...] = ()
    discrepancy: tuple[FoundFamily, ...] = ()
    linear: Linearised | None = None

    @cached_property
    def belief(self) -> Belief:
        """Result with all that is known of its uncertainty."""
        return total(self.run.belief, self.contributions)

    @property
    def blocks(self) -> Blocks | None:
        """What blocks of the recording say about the parameters, if that is known already."""
        blocks = None if self.linear is None else self.linear.blocks
        if blocks is None or self.linear is None:
            return None
        step = self.problem.layout.minus(self.run.belief.mean[:, None], self.linear.near.belief.mean)[:, 0]
        return blocks.about(step)

    def first(self, count: int, progress: StepProgress | None = None) -> Fit:
        """Return the fit of the first updates by themselves."""
        known = None if self.linear is None else self.linear.first(count)
        if known is not None:
            return known
        return self.estimator.refit(part_of(self.problem, slice(0, count)), self.run, progress=progress)

    @property
    def recorded(self) -> Problem:
        """The problem with readings and poses as recorded, without corrections by terms for errors on no list."""
        if self.stated is None or not self.discrepancy:
            return self.problem
        readings = replace(self.stated.sensor.readings, noise=self.problem.sensor.readings.noise)
        return replace(with_readings(self.problem, readings), reference=self.stated.reference)

    @property
    def deviation(self) -> Array:
        """Total standard deviation of every degree of freedom (degrees,)."""
        return self.belief.standard_deviation

    @property
    def as_noisy(self) -> Array:
        """Factor (degrees, degrees) of the filter's covariance as large as correlated innovations show it to be."""
        return self.correlation_factor * self.run.belief.factor

    @property
    def common(self) -> Array:
        """Effect of errors that other recordings with the same reference share, (degrees, k)."""
        columns = [one.columns for one in self.contributions if one.common]
        return np.hstack([np.zeros((self.problem.layout.degrees, 0)), *columns])

    def adding(self, contributions: Iterable[Contribution], warnings: Iterable[DataWarning] = ()) -> Estimate:
        """Return the estimate with further contributions to its uncertainty, and warnings about them."""
        more = (*self.contributions, *(one for one in contributions if one.columns.any()))
        return replace(self, contributions=more, warnings=(*self.warnings, *warnings))


def without_passing(found: Estimate) -> Estimate:
    """Return the estimate of what lasts: the marginal distribution without groups that change within seconds."""
    problem, run = found.problem, found.run
    layout, lasting = problem.layout, problem.lasting
    if lasting.size == len(problem.parameter_names):
        return found
    smaller = without(layout, PASSING_GROUPS)
    kept = np.concatenate([np.r_[layout[part.name]] for part in smaller])
    stored = np.concatenate([np.r_[layout.stored(part.name)] for part in smaller])
    history = run.history
    return replace(
        found,
        problem=replace(problem, layout=smaller),
        linear=None,
        contributions=tuple(replace(one, columns=one.columns[kept]) for one in found.contributions),
        run=replace(
            run,
            belief=Belief(run.belief.mean[stored], triangularise(run.belief.factor[kept])),
            parameters=with_nominal(problem, run.parameters, PASSING_GROUPS),
            history=replace(
                history, parameters=history.parameters[:, lasting], deviations=history.deviations[:, lasting]
            ),
        ),
    )

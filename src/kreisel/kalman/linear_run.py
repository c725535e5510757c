"""A run of the filter with the slopes of all its updates: answers to many questions without another run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.estimation.consistency import gate_bounds
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.blocks import Blocks, increments
from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import parameters_of
from kreisel.fitting.terms import Linearisation, Scores, Terms
from kreisel.geometry.rotation import Array, Indices
from kreisel.kalman.elimination import Elimination
from kreisel.kalman.noise_shares import variance_of_reference
from kreisel.kalman.run_slopes import Slopes
from kreisel.kalman.scores import Gradients, gradients, scores_of, walk_score
from kreisel.kalman.sensitivity import Sensitivity
from kreisel.model.parameters import WALKING_GROUPS
from kreisel.model.problem import Problem, part_of


@dataclass(frozen=True)
class LinearRun:
    """See `fitting.fit.Linearised`.

    Attributes
    ----------
    problem, near
        What was run, near which fit.
    run, fit
        The run, and the fit: its result with the stated prior.
    known
        What is known of the parameters by the run, the belief it started with, and the prior.
    slopes
        Of all its updates.
    ends, found
        Updates before which blocks end, and the beliefs before the first of all and at these.
    with_prior
        Returns a run of a problem with the stated prior in place of the belief that it began with.
    """

    problem: Problem
    near: Fit
    run: Fit
    fit: Fit
    known: Elimination
    slopes: Slopes
    ends: Indices
    found: list[Belief]
    with_prior: Callable[[Problem, Fit, Belief], Fit]

    @cached_property
    def blocks(self) -> Blocks | None:
        """What each block says; None if a gate that leaves out updates would have left out some."""
        history = self.run.history
        if np.any(history.nis > self.near.gate * gate_bounds(history.degrees)):
            return None
        return blocks_of(self.problem, self.near, self.ends, self.found)

    def first(self, count: int) -> Fit | None:
        """Return the fit of the first updates, up to the end of a block; None if it takes another run.

        A fit by predicted readings does, for it is not by a run.
        """
        at = np.flatnonzero(self.ends == count)
        if self.blocks is None or self.near.motion is not None or at.size == 0:
            return None
        belief = self.found[1 + int(at[0])]
        run = replace(
            self.run,
            belief=belief,
            parameters=parameters_of(self.problem, self.run.start, belief.mean),
            history=self.run.history.first(count),
        )
        return self.with_prior(part_of(self.problem, slice(0, count)), run, self.found[0])

    def about(self, terms: Terms, *, innovations: bool = False) -> Linearisation:
        """Return what the data say of terms outside the state."""
        beside = Sensitivity(self.problem, terms, self.slopes, kept=innovations)
        found = eliminated(self.known, beside)
        return replace(found, innovations=beside.innovations) if innovations else found

    def scores(self, terms: Terms) -> Scores:
        """Return the scores of terms outside the state."""
        return scores_of(self._gradients, terms)

    def walk_score(self, group: str) -> Scores:
        """Return the score of a random walk of a group of parameters."""
        part = self.problem.layout[group]
        places = np.flatnonzero(np.isin(self._walking, np.arange(part.start, part.stop)))
        return walk_score(self._gradients, places, self.slopes.seconds)

    def variance_of_reference(self) -> dict[Source, Array]:
        """Return the variances (n,) of all parameters by the reference's noise, by source."""
        return variance_of_reference(self.problem, self.run, self.slopes, self.known)

    @property
    def _walking(self) -> Indices:
        layout = self.problem.layout
        parts = [layout[group] for group in WALKING_GROUPS if group in layout]
        return np.concatenate([np.zeros(0, dtype=np.int64), *(np.arange(p.start, p.stop) for p in parts)])

    @cached_property
    def _gradients(self) -> Gradients:
        return gradients(self.problem, self.slopes, self.known, self._walking)


def blocks_of(problem: Problem, near: Fit, ends: Indices, found: list[Belief]) -> Blocks:
    """Return the blocks of a run near a fit, from its beliefs before the first update and at the ends."""
    constant = problem.constant(near.belief.standard_deviation)
    means = np.stack([belief.mean for belief in found], axis=1)
    distance = problem.layout.minus(means, near.belief.mean)[constant].T
    covariance = np.stack([belief.factor[constant] @ belief.factor[constant].T for belief in found])
    return increments(constant, ends, distance, covariance)


def eliminated(known: Elimination, beside: Sensitivity) -> Linearisation:
    """Return what a run says of terms outside the state, about its result with the stated prior.

    Notes
    -----
    With amplitudes b, derivatives V of the parameters and N of the whitened innovations, a run that begins with the
    information B about the parameters ends with I: in the parameters and b, its log-likelihood has the blocks I, -I V
    and V' I V + N' N. With the stated prior A, I - B + A stands for the first; the parameters are then eliminated.
    """
    V = beside.state[: known.scale.size] / known.scale[:, None]
    pull = known.run @ V
    change = np.linalg.solve(known.information, pull)
    return Linearisation(
        known.scale[:, None] * change,
        beside.information + pull.T @ (V - change),
        beside.score + pull.T @ known.step(known.to_begun, known.to_prior),
        beside.part_information,
        beside.part_scores,
        beside.misfit,
        beside.degrees,
    )

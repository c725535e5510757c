"""What an estimator gives, and what an estimator is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.terms import Linearisation, Scores, Terms
from kreisel.fitting.update_history import History
from kreisel.geometry.pose_spline import PoseSpline
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress

WIDE_GATE = 100.0
"""Factor on the gate where it must reject gross errors alone: parameters are still far from their final values, terms
are looked for that would explain what it rejects, or noise was added to the readings. Chosen: ten times the
deviations."""


@dataclass(frozen=True)
class Fit:
    """A problem's result by an estimator: value, covariance, innovations.

    Attributes
    ----------
    start
        Parameters about which the model was linearised first.
    belief
        Mean and covariance of the whole state: what data and stated prior say.
    parameters
        Those in the mean, and known ones.
    history
        What happened at every update.
    fitted
        How many parameters were fitted to the same data before: the innovations are smaller by so many degrees of
        freedom.
    jumps
        How often parameters with a random walk may have jumped.
    begun, gate
        The belief and the gate it began with, where the estimator is recursive.
    about : (u, size)
        Stored states before the updates, that the model was linearised about, where these are not the estimates.
    motion
        From which readings were predicted, where they were.
    """

    start: CellParameters
    belief: Belief
    parameters: CellParameters
    history: History
    fitted: float = 0.0
    jumps: int = 0
    begun: Belief | None = None
    gate: float = 1.0
    about: Array | None = None
    motion: PoseSpline | None = None

    @property
    def excess(self) -> float:
        """Factor on normalised innovations squared for the degrees of freedom fitted before; 1 where none were."""
        degrees = float(np.sum(self.history.degrees[self.history.used]))
        return degrees / max(degrees - self.fitted, 0.3 * degrees, 1.0) if degrees > 0.0 else 1.0


class Linearised(Protocol):
    """A problem linearised about a fit: what its data say of anything, to first order and without another run."""

    @property
    def near(self) -> Fit:
        """The fit that it is about."""
        ...

    @property
    def fit(self) -> Fit:
        """The fit of the problem near that fit."""
        ...

    @property
    def blocks(self) -> Blocks | None:
        """What the blocks of updates that end at `fitting.partition.block_ends` say; None if it takes another run."""
        ...

    def first(self, count: int) -> Fit | None:
        """Return the fit of the first updates, up to the end of a block; None if it takes another run."""
        ...

    def about(self, terms: Terms, *, innovations: bool = False) -> Linearisation:
        """Return what the data say of terms outside the state; innovations: with what they do to each of these."""
        ...

    def scores(self, terms: Terms) -> Scores:
        """Return the scores of terms outside the state: much cheaper than their information."""
        ...

    def walk_score(self, group: str) -> Scores:
        """Return the score of the variance of a random walk of a group of parameters."""
        ...

    def variance_of_reference(self) -> Mapping[Source, Array]:
        """Return what the reference's noise adds to the variance of each parameter, (n,), by source."""
        ...


class Estimator(Protocol):
    """What estimates the parameters of a problem from all its updates.

    Every further step asks an estimator for fits, whichever it is: noise figures, effects, halves, cross-validation,
    intervals, latitude. A fit contains the problem's stated prior and nothing of a start. `gate` is a factor on the
    bound of innovations beyond which updates are left out.

    Notes
    -----
    The state is that of `problem.layout`: all groups, then errors of the reference, then navigation at the last update;
    the belief is of all of it. Groups in `problem.noise.gauss_markov` are Gauss-Markov processes, those in
    `problem.noise.offset_walk` walk at random: the belief is of their values at the last update. A likelihood is that
    of innovations given all earlier ones and the belief it began with: it compares between fits of `repeat`, and of
    `refit` from one fit. All methods raise an EstimationError where the state does not stay finite.
    """

    @property
    def name(self) -> str:
        """Its name in settings and results."""
        ...

    @property
    def points(self) -> str | None:
        """Which sigma points or derivatives it goes by; None if as the settings say."""
        ...

    def fit(self, problem: Problem, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from its start values."""
        ...

    def refit(self, problem: Problem, near: Fit, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem whose result lies near that of a fit of the same state."""
        ...

    def repeat(self, problem: Problem, fit: Fit, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem of the same state from the same start: only the likelihoods of both compare."""
        ...

    def blocks(self, problem: Problem, near: Fit, ends: Sequence[int], progress: StepProgress | None = None) -> Blocks:
        """Return what each block of updates says about the parameters, linearised about a fit of the problem.

        ends: ascending numbers of the updates before which a block ends; the last is the number of updates.
        """
        ...

    def linearise(self, problem: Problem, near: Fit, progress: StepProgress | None = None) -> Linearised:
        """Return a linearisation of a problem about a fit."""
        ...

    def navigate(self, problem: Problem, known: CellParameters, progress: StepProgress | None = None) -> Fit:
        """Return the innovations of navigation with known parameters; none is left out.

        The problem has no parameters in its state.
        """
        ...

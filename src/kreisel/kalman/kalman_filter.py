"""Kalman filters of state and parameters, the paper's among them, with the prior put in at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.fit import WIDE_GATE, Fit
from kreisel.fitting.partition import block_ends
from kreisel.fitting.stored_state import first_belief
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.linear_run import LinearRun, blocks_of
from kreisel.kalman.prior_exchange import elimination, narrowed_belief, start_near, with_stated_prior
from kreisel.kalman.run_slopes import Slopes
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress


@dataclass(frozen=True)
class KalmanFilter:
    """An estimator by one recursion; see `fitting.fit.Estimator`.

    Attributes
    ----------
    name
        In settings and results.
    points
        Which sigma points, or one of `LINEARISATIONS`; those of the problem's settings if None.
    """

    name: str = "spkf"
    points: str | None = None

    def fit(self, problem: Problem, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from its start values: one pass."""
        return self._pass(problem, problem.prior.start, first_belief(problem, problem.prior.start), gate, progress)

    def refit(self, problem: Problem, near: Fit, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from the result of another one: one pass, linearised about it."""
        return self._pass(problem, start_near(problem, near), narrowed_belief(problem, near), gate, progress)

    def repeat(self, problem: Problem, fit: Fit, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from the belief that another one began with."""
        return self._run(problem, fit.start, gate=fit.gate, progress=progress, belief=fit.begun)

    def blocks(self, problem: Problem, near: Fit, ends: Sequence[int], progress: StepProgress | None = None) -> Blocks:
        """Return what each block of updates says about the parameters: the increments of one pass near a fit."""
        start, begun = start_near(problem, near), narrowed_belief(problem, near)
        found: list[Belief] = [begun]
        self._run(
            problem, start, belief=begun, gate=near.gate, progress=progress, visit=dict.fromkeys(ends, found.append)
        )
        return blocks_of(problem, near, np.asarray(ends), found)

    def linearise(self, problem: Problem, near: Fit, progress: StepProgress | None = None) -> LinearRun:
        """Return a linearisation of a problem about a fit: one pass with the slopes of all its updates."""
        start, begun, slopes = start_near(problem, near), narrowed_belief(problem, near), Slopes(problem)
        ends, found = block_ends(problem), [begun]
        run = self._run(
            problem, start, belief=begun, gate=WIDE_GATE, progress=progress,
            visit=dict.fromkeys(ends, found.append), slopes=slopes,
        )  # fmt: skip
        fit, known = with_stated_prior(problem, run, begun), elimination(problem, run, begun)
        return LinearRun(problem, near, run, fit, known, slopes, np.asarray(ends), found, with_stated_prior)

    def navigate(self, problem: Problem, known: CellParameters, progress: StepProgress | None = None) -> Fit:
        """Return the innovations of navigation with known parameters; none is rejected."""
        return self._run(problem, known, gate=np.inf, progress=progress)

    def begin(self, problem: Problem, start: CellParameters, belief: Belief, *, gate: float = 1.0) -> Fit:
        """Return the plain run of the filter from a belief, which its result contains."""
        return self._run(problem, start, gate=gate, belief=belief)

    def _pass(
        self, problem: Problem, start: CellParameters, begun: Belief, gate: float, progress: StepProgress | None
    ) -> Fit:
        run = self._run(problem, start, belief=begun, gate=gate, progress=progress)
        return with_stated_prior(problem, run, begun)

    def _run(
        self, problem: Problem, start: CellParameters, *, gate: float, progress: StepProgress | None = None,
        belief: Belief | None = None, visit: Mapping[int, Callable[[Belief], None]] | None = None,
        slopes: Slopes | None = None,
    ) -> Fit:  # fmt: skip
        return run_filter(
            problem, start, gate=gate, progress=progress, belief=belief, visit=visit, slopes=slopes, points=self.points
        )

"""Passes over a problem until its result stays where it is and its noise figures fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.estimation.consistency import gate_bounds
from kreisel.fitting.fit import WIDE_GATE, Fit
from kreisel.fitting.nonlinearity import curved
from kreisel.fitting.stored_state import parameters_of
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem
from kreisel.refinement.correlated_innovations import bounded_likelihood
from kreisel.refinement.noise_adaptation import (
    FEW_REJECTED,
    NoiseFactors,
    StatedFigures,
    noise_factors,
    with_factors,
    within_bounds,
)
from kreisel.refinement.rescheduling import assigns_otherwise, rescheduled, with_attitudes_of
from kreisel.refinement.wrong_stamps import with_wrong_stamps

MAX_NOISE_PASSES = 8
"""Largest number of passes to find noise figures where none are given or the given ones are contradicted."""

MAX_PASSES = 14
"""Largest number of passes, if none is requested. Chosen: those that go to and fro in weak motion took 6 to 12 with
extrapolation, and an industrial recording three after `MAX_NOISE_PASSES`; a result that still moves is rejected
(`calibration.verdict.MAX_MOVED`)."""

NEAR = 3.0
"""Change of a parameter by a pass, in standard deviations, above which the gate stays wide for another pass."""

SETTLED = 0.2
"""Change of every parameter by a pass, in standard deviations, below which no further pass is needed."""

_MIN_SHARE = 0.1
"""Of the change by a pass, for the start of the next one."""


class Settling:
    """The last pass over a problem, and what the next one is to be.

    Attributes
    ----------
    problem, run
        Of the last pass.
    count
        Number of passes.
    adapted
        Whether noise figures were changed.
    moved
        How far the last pass moved the estimates, in standard deviations; infinite where the usual gate was not used.
    near
        The fit that the next pass is linearised about: the last one, or one between the last two.
    """

    def __init__(self, problem: Problem, run: Fit, given: StatedFigures) -> None:
        """Begin with the first pass, which had a wide gate."""
        self.problem, self.run, self.near = problem, run, run
        self.count, self.adapted, self.moved = 1, False, np.inf
        self._given = given
        self._far, self._still, self._goes_back = True, False, False
        self._likeliest = (-np.inf, problem, run)
        self._before, self._share, self._change = run, 1.0, np.zeros(0)

    @property
    def gate(self) -> float:
        """The gate of the next pass: a wide one as long as the result may be far off."""
        return WIDE_GATE if self._far else 1.0

    def following(self) -> Problem | None:
        """Return the problem of the next pass; None if another one is neither requested nor useful."""
        factors = self._factors()
        marked = with_wrong_stamps(self.problem, self.run) if factors.agree() else self.problem
        settled = (factors.agree() and marked is self.problem) or self.count >= MAX_NOISE_PASSES
        if settled and not another_pass(self.problem, self.run, self.moved, self.count):
            return None
        clock = self.run.parameters.clock
        if self.count == 1:
            self._far = curved(self.problem, self.run) or assigns_otherwise(self.problem, clock)
        self.near = self.run if self._share == 1.0 else between(self.problem, self._before, self.run, self._share)
        problem = rescheduled(with_attitudes_of(marked, self.run), clock)
        if factors.agree():
            return problem
        self.adapted = True
        return with_factors(problem, factors)

    def take(self, problem: Problem, run: Fit) -> None:
        """Take the next pass, made near `near` with the gate `gate`."""
        self.count += 1
        self.problem, self.run, self._before = problem, run, self.near
        change, self._change = self._change, change_of(problem, self.near, run)
        self._share = relaxation(self._share, change, self._change)
        self.moved = float(np.max(np.abs(self._change), initial=0.0))
        self._still = self.moved <= SETTLED
        if self._far:
            self._far = self.moved > NEAR
            if wide_gate_mattered(run):
                self.moved = np.inf

    def _factors(self) -> NoiseFactors:
        """Return the factors on noise figures that the last pass asks for.

        Where they do not come to rest, all goes back to the likeliest pass: what makes the noise larger from pass to
        pass is no noise.
        """
        beyond = float(np.mean(_beyond_gate(self.run) > 1.0))
        rejected = beyond if self._still else 1.0 - float(np.mean(self.run.history.used))
        factors = noise_factors(self.problem, self.run)
        factors = factors.contradicted(reference=self._given.reference, imu=self._given.imu, rejected=rejected)
        factors = within_bounds(self.problem, factors)
        if self.count == 1 and self.problem.reference.quaternions is None:
            factors = NoiseFactors()  # the attitude was a guess: such innovations do not show the noise
        likelihood, problem, run = self._likeliest
        if not factors.agree() and self.count == MAX_NOISE_PASSES and likelihood > bounded_likelihood(self.run):
            self.problem, self.run, self._goes_back = problem, run, True
            self._share, self._change = 1.0, np.zeros(0)
        if self._goes_back:
            return NoiseFactors()
        if beyond < FEW_REJECTED:
            this = (bounded_likelihood(self.run), self.problem, self.run)
            self._likeliest = max(self._likeliest, this, key=lambda one: one[0])
        return factors


def relaxation(share: float, before: Array, after: Array) -> float:
    """Return the share of the last change that the next pass starts with, from that of the one before and both changes.

    In weak motion a pass may answer to its start with the opposite change, and passes would go to and fro for ever.

    Notes
    -----
    Aitken's extrapolation for vectors (Irons and Tuck 1969), within bounds.
    """
    if before.size == 0:
        return 1.0
    turned = after - before
    return float(np.clip(-share * (before @ turned) / max(float(turned @ turned), 1e-300), _MIN_SHARE, 1.0))


def between(problem: Problem, a: Fit, b: Fit, share: float) -> Fit:
    """Return the second of two runs with a result between them, by a share of the way."""
    change = problem.layout.minus(b.belief.mean[:, None], a.belief.mean)
    mean = problem.layout.plus(a.belief.mean, share * change)[:, 0]
    return replace(b, belief=replace(b.belief, mean=mean), parameters=parameters_of(problem, b.parameters, mean))


def change_of(problem: Problem, before: Fit, after: Fit) -> Array:
    """Return the change of each lasting parameter between two results, in standard deviations."""
    change = problem.layout.minus(after.belief.mean[:, None], before.belief.mean)[problem.lasting, 0]
    return np.asarray(change / after.belief.standard_deviation[problem.lasting])


def another_pass(problem: Problem, run: Fit, moved: float, count: int) -> bool:
    """Return whether another pass is requested, or useful.

    After the first pass another one is useful if the wide gate accepted updates that the usual gate would reject
    (grossly, or often), if the clocks assign poses to other samples, or if the model is curved between start and
    result. Later it is useful as long as the estimates move.
    """
    if problem.settings.passes is not None:
        return count < problem.settings.passes
    if count >= MAX_PASSES:
        return False
    if count > 1:
        return moved > SETTLED
    if wide_gate_mattered(run) or problem.settings.polynomial_order > 1 or problem.reference.quaternions is None:
        return True
    return assigns_otherwise(problem, run.parameters.clock) or curved(problem, run)


def wide_gate_mattered(run: Fit) -> bool:
    """Return whether a wide gate accepted updates that the usual one would reject: grossly, or often."""
    beyond = run.history.used * _beyond_gate(run)
    return bool((beyond > 4.0).any()) or float(np.mean(beyond > 1.0)) > 0.002


def _beyond_gate(run: Fit) -> Array:
    """Return the normalised innovations squared of all updates over the bound of the usual gate, (u,)."""
    return np.asarray(run.history.nis / gate_bounds(run.history.degrees))

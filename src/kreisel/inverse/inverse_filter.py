"""The inverse filter: a smooth motion and the sensors' parameters that predict readings and poses best.

A filter that goes forwards integrates the readings and compares poses. This one differentiates a motion and compares
readings: the way of Fox and Janocha's earlier work, and of calibrations of cameras (Furgale, Rehder and Siegwart 2013).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np
from numpy.linalg import LinAlgError

from kreisel.errors import EstimationError
from kreisel.fitting.blocks import Blocks
from kreisel.fitting.fit import Estimator, Fit, Linearised
from kreisel.fitting.result_change import result_moved
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.pose_spline import PoseSpline
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.inverse.normal_equations import NormalEquations
from kreisel.inverse.pose_rows import pose_rows
from kreisel.inverse.reading_rows import raw_samples, reading_rows
from kreisel.inverse.spline_knots import first_spline, spacing_of
from kreisel.inverse.unknowns import Unknowns, unknowns_of
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress

SETTLED = 0.05
"""Change of every parameter by an iteration, in standard deviations, below which no further one is needed."""

MAX_ITERATIONS = 10
"""Largest number of iterations. Chosen: from the result of a filter two to four are needed."""

STEADY = 1e-6
"""Weight of third differences of the control points' steps, 1/m^2 and 1/rad^2: a millionth of what a pose that is
known to a metre or a radian says. It only decides where no reading and no pose says anything."""

_MARGIN = 0.05
"""Seconds of the motion beyond the first and the last update."""


@dataclass(frozen=True)
class InverseFilter:
    """Estimates by predicted readings; see `fitting.fit.Estimator`.

    Attributes
    ----------
    forward
        A filter that goes forwards. It starts from a pass of that, which also says which poses are outliers, and gives
        innovations: of navigation near the result. What is asked of a linearisation is asked of it.
    """

    forward: Estimator
    name: str = "inverse"
    points: str = "spline"

    def fit(self, problem: Problem, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from its start values."""
        first = self.forward.fit(problem, gate=gate)
        return inverted(problem, self.forward.refit(problem, first, gate=gate), progress)

    def refit(self, problem: Problem, near: Fit, *, gate: float = 1.0, progress: StepProgress | None = None) -> Fit:
        """Return the fit of a problem from the result of another one."""
        return inverted(problem, replace(self.forward.refit(problem, near, gate=gate), motion=near.motion), progress)

    def repeat(self, problem: Problem, fit: Fit, progress: StepProgress | None = None) -> Fit:
        """Return the forward pass of a problem from the belief that another one began with, for its likelihood."""
        return self.forward.repeat(problem, fit, progress)

    def blocks(self, problem: Problem, near: Fit, ends: Sequence[int], progress: StepProgress | None = None) -> Blocks:
        """Return what each block of updates says about the parameters, by a forward pass near a fit."""
        return self.forward.blocks(problem, near, ends, progress)

    def linearise(self, problem: Problem, near: Fit, progress: StepProgress | None = None) -> Linearised:
        """Return a linearisation of a problem about a fit, by a forward pass."""
        return self.forward.linearise(problem, near, progress)

    def navigate(self, problem: Problem, known: CellParameters, progress: StepProgress | None = None) -> Fit:
        """Return the innovations of navigation with known parameters; none is rejected."""
        return self.forward.navigate(problem, known, progress)


def inverted(problem: Problem, near: Fit, progress: StepProgress | None = None) -> Fit:
    """Return a forward fit with the parameters, and their covariance, that predicted readings give.

    Raises
    ------
    EstimationError
        If the reference lacks positions or orientations, or the equations have no solution.
    """
    n = len(problem.parameter_names)
    if n == 0:
        return near
    spline, unknowns, covariance = smooth_motion(problem, near, progress)
    state = stored_state(problem, unknowns.known)
    step = problem.layout.minus(state[:, None], near.belief.mean)[:n, 0]
    return replace(result_moved(problem, near, step, covariance[:n, :n]), motion=spline)


def smooth_motion(
    problem: Problem, near: Fit, progress: StepProgress | None = None
) -> tuple[PoseSpline, Unknowns, Array]:
    """Return the motion and the parameters that predict readings and poses best, and the latter's covariance."""
    if find_spec("scipy") is None:
        raise EstimationError("the inverse filter needs SciPy: run pip install 'kreisel[inverse]'")
    if problem.settings.size_effect is not SizeEffect.COMPLETED:
        raise EstimationError(
            "the inverse filter knows the size effect in its completed form only; choose another estimator"
        )
    updates, stamps = problem.schedule.updates, problem.sensor.readings.stamps
    begin, end = float(stamps[updates[0].last]) - _MARGIN, float(stamps[updates[-1].last]) + _MARGIN
    unknowns = unknowns_of(problem, near.parameters, begin, end)
    spline = near.motion
    if spline is None or not spline.reaches(begin, end):
        samples = raw_samples(unknowns, begin, end)
        spacing = spacing_of(samples.seconds, samples.rates, samples.forces, samples.deviation)
        spline = first_spline(problem, near.parameters, begin, end, spacing)
    for count in range(MAX_ITERATIONS):
        samples = raw_samples(unknowns, begin, end, spline)
        equations = NormalEquations(len(spline.positions), unknowns.count)
        for rows in (*pose_rows(unknowns, spline, near.history.used), *reading_rows(unknowns, spline, samples)):
            equations.add(rows)
        equations.steady(STEADY)
        try:
            points, step, covariance = equations.solve(*unknowns.prior())
        except LinAlgError as error:
            raise EstimationError(f"the inverse filter's equations have no solution ({error})") from error
        spline, unknowns = spline.moved(points), unknowns.moved(step)
        moved = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        if progress is not None:
            progress((count + 1) / MAX_ITERATIONS)
        if not np.isfinite(moved):
            raise EstimationError("the inverse filter's state is no longer finite; check units and noise figures")
        if moved < SETTLED:
            break
    return spline, unknowns, covariance

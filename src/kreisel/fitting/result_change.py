"""A run with another result for its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import parameters_of
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem


def regression_on_parameters(belief: Belief, n: int) -> Array:
    """Return how the state follows from its first n degrees of freedom, the parameters, (degrees, n)."""
    P = belief.covariance
    own = np.sqrt(np.diag(P)[:n])
    rest = (np.linalg.solve(P[:n, :n] / np.outer(own, own), P[:n, n:] / own[:, None]) / own[:, None]).T
    return np.vstack([np.eye(n), rest])


def result_moved(problem: Problem, run: Fit, step: Array, covariance: Array | None = None) -> Fit:
    """Return a run with another result for the parameters, (n,) away and of covariance (n, n), by default its own.

    The rest of the state follows by its regression on the parameters.
    """
    layout, n = problem.layout, step.size
    gain, factor = regression_on_parameters(run.belief, n), run.belief.factor
    mean = layout.plus(run.belief.mean, (gain @ step)[:, None])[:, 0].copy()
    if covariance is not None:
        old = run.belief.covariance
        new = old + gain @ (covariance - old[:n, :n]) @ gain.T
        new[:n, :n] = covariance
        scale = np.sqrt(np.diag(new))
        correlation = new / np.outer(scale, scale)
        factor = scale[:, None] * np.linalg.cholesky(0.5 * (correlation + correlation.T) + 1e-13 * np.eye(scale.size))
    return replace(run, belief=Belief(mean, factor), parameters=parameters_of(problem, run.parameters, mean))


def with_unit_of_data(problem: Problem, run: Fit) -> Fit:
    """Return a run without what noise does to the scale of positions, where that is estimated.

    With a longer unit of the reported positions all of the motion, the distances, offsets and gravity are smaller by
    one factor, and the accelerometers' matrix with them. No data tell them apart, unless gravity is known. Yet
    innovations become smaller too, noise included, while their assumed variances stay: each row of position or velocity
    pulls at the unit by its share of the misfit, by equation (41). In 40 minutes of good cameras this is a scale factor
    of half a per cent.
    """
    if "position_scale" not in problem.layout:
        return run
    n, place = len(problem.parameter_names), problem.layout["position_scale"].start
    return result_moved(problem, run, -run.history.pull_of_unit * run.belief.covariance[:n, place])

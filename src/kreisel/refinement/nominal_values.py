"""Nominal values for a matrix that is not observable, with the uncertainty of what depends on it."""

from __future__ import annotations

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.fitting.result_change import regression_on_parameters, result_moved
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem
from kreisel.refinement.observability import MAX_SHARE

_CONSIDERED = ("accel_cross_coupling",)
"""Matrices that keep their nominal values if they are not observable."""

_DEVICES = 0.015
"""Standard deviation of the elements of such a matrix from nominal ones, as that of non-orthogonality in the prior."""


def with_nominal_values(problem: Problem, run: Fit, factor: float = 1.0) -> tuple[Fit, Array]:
    """Return a run's result with nominal values of matrices of which less than half is observable.

    And what then becomes of another error of the result, (degrees, degrees).

    factor: on the deviations.

    Notes
    -----
    Consider parameters (Schmidt 1966): data that hardly show a parameter, and a reference with errors that nobody
    modelled, must not move it. All else is conditioned on its nominal value, and what usual devices differ from that
    is propagated.
    """
    layout, n = problem.layout, len(problem.parameter_names)
    errors = np.eye(layout.degrees)
    for group in _CONSIDERED:
        if group not in layout or problem.settings.partial or layout.present(group).size < layout.whole(group):
            continue
        d, P = layout[group], run.belief.covariance[:n, :n]
        ratio = factor * np.sqrt(np.diag(P)[d]) / problem.prior.width[group]
        if float(np.median(ratio)) <= MAX_SHARE or problem.known_places[d].any():
            continue
        sensitivity = np.linalg.solve(P[d, d], P[d]).T  # of everything to the group
        prior = _DEVICES**2 * np.eye(d.stop - d.start)
        off = problem.prior.nominal.stored(group) - run.parameters.stored(group)
        covariance = P - sensitivity @ P[d] + sensitivity @ prior @ sensitivity.T / factor**2
        through = regression_on_parameters(run.belief, n) @ sensitivity
        errors -= through @ errors[d]
        run = result_moved(problem, run, sensitivity @ off, 0.5 * (covariance + covariance.T))
    return run, errors

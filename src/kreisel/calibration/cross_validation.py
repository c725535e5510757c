"""Cross-validation: navigation through the part of the recording that the calibration did not use.

Once with nominal and once with calibrated parameters; no truth is needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import CrossValidation, Drift
from kreisel.fitting.fit import Fit
from kreisel.model.layout import without
from kreisel.model.problem import Problem, part_of
from kreisel.progress import Progress, of_step
from kreisel.refinement.estimate import Estimate

TRAINING = 0.6
"""Share of the updates that the calibration for the cross-validation uses."""


def cross_validate(found: Estimate, progress: Progress | None = None) -> CrossValidation:
    """Return the drift on the last part of the recording as recorded, with a calibration of its first part only."""
    problem = found.problem
    count = len(problem.schedule.updates)
    cut = int(TRAINING * count)
    trained = found.estimator.refit(part_of(problem, slice(0, cut)), found.run, progress=of_step(progress, "train"))
    nominal = replace(
        problem.prior.nominal, start=trained.parameters.start, skew=trained.parameters.skew,
        q_rn=trained.parameters.q_rn, robot=trained.parameters.robot,
    )  # fmt: skip
    unseen = _navigation_only(part_of(found.recorded, slice(cut, count)))
    return CrossValidation(
        trained_until=float(problem.sensor.readings.stamps[problem.schedule.updates[cut - 1].last]),
        nominal=_drift(found.estimator.navigate(unseen, nominal, of_step(progress, "nominal"))),
        calibrated=_drift(found.estimator.navigate(unseen, trained.parameters, of_step(progress, "calibrated"))),
    )


def _navigation_only(problem: Problem) -> Problem:
    """Return the problem with every parameter assumed known."""
    prior = replace(problem.prior, start_covariance={}, covariance={})
    return replace(problem, layout=without(problem.layout, problem.groups), prior=prior)


def _drift(run: Fit) -> Drift:
    h = run.history
    path = ~h.at_standstill
    path[:2] = False  # navigation has just started
    return Drift(
        h.seconds[path],
        np.linalg.norm(h.innovation[path, 0:3], axis=1),
        np.linalg.norm(h.innovation[path, 3:6], axis=1),
    )

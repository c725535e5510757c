"""Cross-validation: navigation through the part of the recording that the calibration did not use.

Once with nominal and once with calibrated parameters; no truth is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

from kreisel.calibration.evidence import CrossValidation, Drift
from kreisel.fitting.fit import Fit
from kreisel.fitting.partition import nearest_end
from kreisel.geometry.rotation import Array, lengths
from kreisel.model.layout import without
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem, part_of
from kreisel.progress import Progress, of_step
from kreisel.refinement.estimate import Estimate

TRAINING = 0.6
"""Share of the updates that the calibration for the cross-validation uses, to the end of a block."""

NOTHING: Mapping[str, Array] = MappingProxyType({})
"""Groups of parameters that are uncertain: none."""


def cross_validate(found: Estimate, progress: Progress | None = None) -> CrossValidation:
    """Return the drift on the last part of the recording as recorded, with a calibration of its first part only."""
    problem = found.problem
    cut, until = first_part(problem)
    trained = found.first(cut, of_step(progress, "train"))
    nominal = replace(
        problem.prior.nominal, start=trained.parameters.start, skew=trained.parameters.skew,
        q_rn=trained.parameters.q_rn, robot=trained.parameters.robot,
    )  # fmt: skip

    def drift(known: CellParameters, step: str) -> Drift:
        navigate = partial(found.estimator.navigate, progress=of_step(progress, step))
        return drift_of(navigate, found.recorded, cut, known)

    return CrossValidation(until, drift(nominal, "nominal"), drift(trained.parameters, "calibrated"))


def first_part(problem: Problem) -> tuple[int, float]:
    """Return the number of updates of the part that is calibrated, and the IMU's second of the last of them."""
    updates = problem.schedule.updates
    cut = nearest_end(problem, int(TRAINING * len(updates)))
    return cut, float(problem.sensor.readings.stamps[updates[cut - 1].last])


def drift_of(
    navigate: Callable[[Problem, CellParameters], Fit], problem: Problem, cut: int, known: CellParameters
) -> Drift:
    """Return the drift of navigation with known parameters over the updates from number `cut` on."""
    unseen = part_of(problem, slice(cut, len(problem.schedule.updates)))
    return _drift(navigate(navigation_only(unseen), known))


def navigation_only(problem: Problem, uncertain: Mapping[str, Array] = NOTHING) -> Problem:
    """Return the problem with every parameter assumed known, but for groups whose covariances are given."""
    kept = {group: covariance for group, covariance in uncertain.items() if group in problem.groups}
    known = tuple(group for group in problem.groups if group not in kept)
    prior = replace(problem.prior, start_covariance=kept, covariance=kept)
    return replace(problem, layout=without(problem.layout, known), prior=prior)


def _drift(run: Fit) -> Drift:
    h = run.history
    path = ~h.at_standstill
    path[:2] = False  # navigation has just started
    return Drift(
        h.seconds[path],
        lengths(h.innovation[path, 0:3]),
        lengths(h.innovation[path, 3:6]),
    )

"""Which parameters this motion shows, judged by how far it narrowed what was believed before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.filter_run import FilterRun
from kreisel.calibration.parameters import GROUPS, ROBOT_GROUPS, parameter_names
from kreisel.calibration.problem import Problem
from kreisel.geometry.rotation import Array

UNSHOWN = 0.5
"""A standard deviation still above this share of the prior's counts as not shown."""

USEFUL = {
    "gyro_cross_coupling": 3e-3,
    "gyro_offset": 5e-3,
    "accel_cross_coupling": 5e-3,
    "accel_offset": 0.1,
    "lever_arms": 0.03,
    "time_offset": 2e-3,
}
"""Standard deviations (SI) above which a value is of no use to anybody, whatever the prior was."""

HELD_IF_UNSHOWN = ("accel_cross_coupling", "lever_arms", "gyro_polynomial", "accel_polynomial")
"""Groups that do more harm than good when estimated from noise: they are held at their nominal values."""


@dataclass(frozen=True)
class Observability:
    """What the motion shows of every parameter.

    Attributes
    ----------
    names
        Of the estimated parameters, one for each degree of freedom.
    prior, posterior : (n,)
        Standard deviations.
    unobservable
        Names of those that are not shown, or not well enough to be of use; held ones included.
    unshown
        The part of them whose standard deviation hardly fell.
    """

    names: tuple[str, ...]
    prior: Array
    posterior: Array
    unobservable: tuple[str, ...]
    unshown: tuple[str, ...]


def unshown_groups(problem: Problem, deviation: Array) -> tuple[str, ...]:
    """Return the groups of `HELD_IF_UNSHOWN` of which the motion shows less than half.

    Parameters
    ----------
    deviation : (degrees,)
        Posterior standard deviations.
    """
    groups = []
    for group in HELD_IF_UNSHOWN:
        if group == "lever_arms" and problem.reference.positions is None:
            continue  # nothing pulls them away, and what they might be belongs into the other deviations
        if group in problem.layout:
            ratio = deviation[problem.layout[group]] / problem.prior_width[group]
            if float(np.median(ratio)) > UNSHOWN:
                groups.append(group)
    return tuple(groups)


def observability(problem: Problem, run: FilterRun) -> Observability:
    """Return what the motion shows of each parameter."""
    deviation = run.belief.standard_deviation
    names: list[str] = []
    prior: list[float] = []
    posterior: list[float] = []
    unobservable: list[str] = []
    unshown: list[str] = []
    order = problem.settings.polynomial_order
    for group in GROUPS:
        own = parameter_names(group, order, problem.joints)
        if group not in problem.layout:
            if group in problem.held:
                unobservable += own
                unshown += own
            continue
        d = problem.layout[group]
        size = d.stop - d.start
        width = (
            np.resize(problem.prior_width[group], size) if group != "alignment" else problem.prior_width[group][:size]
        )
        for name, before, after in zip(own, width, deviation[d], strict=False):
            names.append(name)
            prior.append(float(before))
            posterior.append(float(after))
            lost = after > UNSHOWN * before
            if group in ("alignment", "north", "earth_down", "gravity", *ROBOT_GROUPS) or (
                lost and group in problem.given_priors
            ):
                lost = False  # believed from the start, and needed by nobody
            if lost:
                unshown.append(name)
            if lost or after > USEFUL.get(group, np.inf):
                unobservable.append(name)
    return Observability(tuple(names), np.array(prior), np.array(posterior), tuple(unobservable), tuple(unshown))

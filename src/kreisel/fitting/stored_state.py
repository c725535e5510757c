"""The state as it is stored: from parameters and to them, and the belief before any data."""

from __future__ import annotations

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.geometry.rotation import Array
from kreisel.model.groups import group_named
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.model.problem import Problem

ATTITUDE_SD, POSITION_SD, VELOCITY_SD = 0.02, 0.02, 0.3
"""Standard deviations (rad, m, m/s) at the start of navigation; large, because the first pose is used again."""


def stored_state(problem: Problem, parameters: CellParameters) -> Array:
    """Return the stored state (size,) with these parameters; all else is zero, and the attitude the identity."""
    x = np.zeros(problem.layout.size)
    x[problem.layout.stored("attitude")] = (1.0, 0.0, 0.0, 0.0)
    for group in problem.groups:
        x[problem.layout.stored(group)] = problem.stored(parameters, group)
    return x


def parameters_of(problem: Problem, known: CellParameters, x: Array) -> CellParameters:
    """Return the parameters in a stored state (size,), and known ones for what is not in it."""
    layout = problem.layout
    values = {group: known.stored(group).copy() for group in GROUPS}
    for group in problem.groups:
        own = x[layout.stored(group)]
        if group_named(group).rotation:
            values[group] = own.copy()
        else:
            values[group][layout.present(group)] = own
    return CellParameters.from_stored(values)


def first_belief(problem: Problem, start: CellParameters, covariance: dict[str, Array] | None = None) -> Belief:
    """Return the belief before the first update: parameters at `start` with the covariance of each group.

    The default covariance is that of the problem's start.
    """
    covariance = problem.prior.start_covariance if covariance is None else covariance
    layout = problem.layout
    mean = stored_state(problem, start)
    factor = np.zeros((layout.degrees, layout.degrees))
    for part in layout:
        if part.name in covariance:
            d = layout[part.name]
            factor[d, d] = np.linalg.cholesky(covariance[part.name])
    others = {"attitude": ATTITUDE_SD, "velocity": VELOCITY_SD, "position": POSITION_SD}
    if "standstill_position" in layout:
        others["standstill_position"], others["standstill_orientation"] = problem.noise.standstill_error
    if (coloured := problem.noise.coloured).time > 0.0:
        sizes = {"path_position": coloured.position, "path_orientation": coloured.orientation}
        others |= {name: size for name, size in sizes.items() if name in layout}
    for name, deviation in others.items():
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return Belief(mean, factor)

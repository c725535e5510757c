"""The state as it is stored: from parameters and to them, and the belief before any data."""

from __future__ import annotations

import math

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.geometry.rotation import Array
from kreisel.model.groups import group_named
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.model.problem import Problem

_ATTITUDE_SD, _POSITION_SD, _VELOCITY_SD = 0.02, 0.02, 0.3
"""Least standard deviations (rad, m, m/s) at the start of navigation; large, because the first pose is used again."""

_TIMES, _FARTHEST = 3.0, 0.2
"""Deviations of a pose's noise from which on the start is as uncertain, and largest deviation of its attitude, rad."""

_SLOPE = 0.1
"""s: least time over which `reported_poses.pose_near` takes a velocity."""

_FRAME = 0.05
"""Rotation and scale of the positions' frame, rad and relative, which move the first position of cameras and satellites
by its distance from the mean. Chosen: five times the deviation of `position_heading`."""


def stored_state(problem: Problem, parameters: CellParameters) -> Array:
    """Return the stored state (size,) with these parameters; all else is zero, and the attitude the identity."""
    x = np.zeros(problem.layout.size)
    x[problem.layout.stored("attitude")] = (1.0, 0.0, 0.0, 0.0)
    for group in problem.groups:
        x[problem.layout.stored(group)] = problem.stored(parameters, group)
    return x


def navigation_deviations(problem: Problem) -> dict[str, float]:
    """Return the deviations of attitude (rad), velocity (m/s) and position (m) where navigation starts at a pose."""
    reference, noise = problem.reference, problem.noise.reference
    attitude = min(max(_ATTITUDE_SD, _TIMES * noise.orientation), _FARTHEST)
    if reference.positions is None:
        return {"attitude": attitude, "velocity": _VELOCITY_SD, "position": _POSITION_SD}
    velocity = _TIMES * math.sqrt(2.0) * noise.position / max(_SLOPE, reference.interval)
    position = _TIMES * noise.position
    if problem.noise.volume_sd > 0.0:
        position = max(position, _FRAME * reference.extent)
        velocity = max(velocity, _FRAME * reference.fastest)
    return {
        "attitude": attitude, "velocity": max(_VELOCITY_SD, velocity), "position": max(_POSITION_SD, position),
    }  # fmt: skip


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
    others = navigation_deviations(problem)
    if "standstill_position" in layout:
        others["standstill_position"], others["standstill_orientation"] = problem.noise.standstill_error
    if (coloured := problem.noise.coloured).time > 0.0:
        sizes = {"path_position": coloured.position, "path_orientation": coloured.orientation}
        others |= {name: size for name, size in sizes.items() if name in layout}
    for name, deviation in others.items():
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return Belief(mean, factor)

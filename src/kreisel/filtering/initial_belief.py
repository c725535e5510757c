"""The filter's belief at its start: at the first update, where navigation starts again."""

from __future__ import annotations

import numpy as np

from kreisel.estimation.belief import Belief, renew
from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.model.problem import Problem
from kreisel.recording.recording import ReferencePoses

_ATTITUDE_SD, _POSITION_SD, _VELOCITY_SD = 0.02, 0.02, 0.3
"""Standard deviations (rad, m, m/s) at the start of navigation; large, because the first pose is used again."""

_VELOCITY_SD_WITHOUT_POSITIONS = 1.0
"""m/s."""


def stored_state(problem: Problem, parameters: CellParameters) -> Array:
    """Return the stored state (size,) with these parameters; all else is zero, and the attitude the identity."""
    x = np.zeros(problem.layout.size)
    x[problem.layout.stored("attitude")] = (1.0, 0.0, 0.0, 0.0)
    for group in problem.groups:
        x[problem.layout.stored(group)] = parameters.stored(group)
    return x


def parameters_of(problem: Problem, known: CellParameters, x: Array) -> CellParameters:
    """Return the parameters in a stored state (size,), and known ones for groups that are not in it."""
    layout = problem.layout
    return CellParameters.from_stored(
        {group: (x[layout.stored(group)] if group in layout else known.stored(group)).copy() for group in GROUPS}
    )


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
    others = {"attitude": _ATTITUDE_SD, "velocity": _VELOCITY_SD, "position": _POSITION_SD}
    if "standstill_position" in layout:
        others["standstill_position"], others["standstill_orientation"] = problem.noise.standstill_error
    if (coloured := problem.noise.coloured).time > 0.0:
        sizes = {"path_position": coloured.position, "path_orientation": coloured.orientation}
        others |= {name: size for name, size in sizes.items() if name in layout}
    for name, deviation in others.items():
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return Belief(mean, factor)


def navigation_from_reference(problem: Problem, known: CellParameters, belief: Belief, at: int) -> Belief:
    """Return the belief with navigation started again at an update's first sample, its own or the previous update's."""
    layout, reference, item = problem.layout, problem.reference, problem.schedule.updates[at]
    attitude = problem.schedule.attitude[at if item.first == item.last else at - 1]
    t = problem.readings.stamps[item.first]
    parameters = parameters_of(problem, known, belief.mean)
    q, p, v = pose_near(reference, float(parameters.clock.reference_time(t)))
    turned, moved = reference.quaternions is not None, reference.positions is not None
    for name, value, deviation in (
        ("attitude", q if turned else attitude, _ATTITUDE_SD if turned else problem.schedule.attitude_sd),
        ("velocity", v, _VELOCITY_SD if moved else _VELOCITY_SD_WITHOUT_POSITIONS),
        ("position", p, _POSITION_SD),
    ):
        belief = renew(layout, belief, name, value, deviation)
    return belief


def pose_near(reference: ReferencePoses, at: float) -> tuple[Array, Array, Array]:
    """Return attitude, position and velocity at a reference time, by linear interpolation of the poses around it."""
    tau = reference.seconds
    k = int(np.clip(np.searchsorted(tau, at) - 1, 0, tau.size - 2))
    width = max(1, round(0.05 / float(np.median(np.diff(tau)))))
    low, high = max(k - width + 1, 0), min(k + width, tau.size - 1)
    share = (at - tau[k]) / (tau[k + 1] - tau[k])
    q, p, v = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    if reference.positions is not None:
        p = (1.0 - share) * reference.positions[k] + share * reference.positions[k + 1]
        v = (reference.positions[high] - reference.positions[low]) / (tau[high] - tau[low])
    if reference.quaternions is not None:
        q = slerp(reference.quaternions[k], reference.quaternions[k + 1], share)
    return q, p, v

"""The start of navigation in a filter's belief: by the reference, at the first update and behind gaps."""

from __future__ import annotations

import numpy as np

from kreisel.estimation.belief import Belief, renew
from kreisel.fitting.stored_state import ATTITUDE_SD, POSITION_SD, VELOCITY_SD, parameters_of
from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import Array
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.recording.recording import ReferencePoses

_VELOCITY_SD_WITHOUT_POSITIONS = 1.0
"""m/s."""


def navigation_from_reference(problem: Problem, known: CellParameters, belief: Belief, at: int) -> Belief:
    """Return the belief with navigation started again at an update's first sample, its own or the previous update's."""
    layout, reference, item = problem.layout, problem.reference, problem.schedule.updates[at]
    attitude = problem.schedule.attitude[at if item.first == item.last else at - 1]
    t = problem.sensor.readings.stamps[item.first]
    parameters = parameters_of(problem, known, belief.mean)
    q, p, v = pose_near(reference, float(parameters.clock.reference_time(t)))
    turned, moved = reference.quaternions is not None, reference.positions is not None
    for name, value, deviation in (
        ("attitude", q if turned else attitude, ATTITUDE_SD if turned else problem.schedule.attitude_sd),
        ("velocity", v, VELOCITY_SD if moved else _VELOCITY_SD_WITHOUT_POSITIONS),
        ("position", p, POSITION_SD),
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

"""The start of navigation in a filter's belief: by the reference, at the first update and after gaps."""

from __future__ import annotations

import numpy as np

from kreisel.estimation.belief import Belief, renew
from kreisel.fitting.reported_poses import pose_near
from kreisel.fitting.stored_state import navigation_deviations
from kreisel.geometry.rotation import multiply
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem

_VELOCITY_SD_WITHOUT_POSITIONS = 1.0
"""m/s."""


def navigation_from_reference(problem: Problem, known: CellParameters, belief: Belief, at: int) -> Belief:
    """Return the belief with navigation started again at an update's first sample, its own or the previous update's.

    known: parameters by which the reference's poses are related to the IMU's clock and body.
    """
    layout, reference, item = problem.layout, problem.reference, problem.schedule.updates[at]
    near = at if item.first == item.last else at - 1
    attitude = problem.schedule.attitude[near]
    t = problem.sensor.readings.stamps[item.first]
    q, p, v = pose_near(reference, float(known.clock.reference_time(t)))
    if problem.robot is not None and (zeros := known.robot.zeros).any():
        (shift,), (turn,) = problem.robot.moved_poses(np.array([problem.schedule.updates[near].pose]), zeros)
        q, p = multiply(q, turn), p + shift
    turned, moved = reference.quaternions is not None, reference.positions is not None
    deviations = navigation_deviations(problem)
    for name, value, deviation in (
        ("attitude", q if turned else attitude, deviations["attitude"] if turned else problem.schedule.attitude_sd),
        ("velocity", v, deviations["velocity"] if moved else _VELOCITY_SD_WITHOUT_POSITIONS),
        ("position", p, deviations["position"]),
    ):
        belief = renew(layout, belief, name, value, deviation)
    return belief

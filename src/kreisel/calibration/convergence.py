"""Convergence of estimates over time, when the filter starts with the grade of the device only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.outcome import Outcome
from kreisel.estimation.belief import Belief
from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.parameters import CellParameters

_UNKNOWN_OFFSET = 0.3
"""m/s^2; standard deviation of an accelerometer's offset where no grade is stated."""


@dataclass(frozen=True)
class Convergence:
    """Estimates of the accelerometers' offsets over time: seconds (u,), offsets and deviations (u, 3), m/s^2."""

    seconds: Array
    offsets: Array
    deviations: Array

    def time_within(self, bound: float, truth: Array) -> float:
        """Return the seconds after which every offset stays within `bound` of the truth (3,); nan if never."""
        outside = np.flatnonzero(np.any(np.abs(self.offsets - truth) > bound, axis=1))
        after = 0 if outside.size == 0 else int(outside[-1]) + 1
        return float(self.seconds[after]) if after < self.seconds.size else float("nan")


def offset_convergence(outcome: Outcome) -> Convergence:
    """Return the convergence of the accelerometers' offsets when the filter starts without estimates of them.

    The calibration itself starts from least squares over the whole recording. This run is made for the figure only:
    it starts from zero offsets and the device's grade, as a filter does that runs during the motion.
    """
    problem = outcome.problem
    layout, group = problem.layout, "accel_offset"
    sensors = problem.prior.start.sensors
    k_a = sensors.k_a.copy()
    k_a[0] = 0.0
    start: CellParameters = replace(problem.prior.start, sensors=replace(sensors, k_a=k_a))
    known = outcome.preparation.imu_noise.accel_offset_sd or _UNKNOWN_OFFSET
    belief = first_belief(problem, start)
    factor = belief.factor.copy()
    factor[layout[group], layout[group]] = known * np.eye(layout.present(group).size)
    run = KalmanFilter().begin(problem, start, Belief(belief.mean, factor))
    history, d = run.history, layout[group]
    return Convergence(history.seconds, history.parameters[:, d], history.deviations[:, d])

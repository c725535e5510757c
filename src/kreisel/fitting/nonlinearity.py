"""Nonlinearity of the model: how large the start deviations of a pass may be, and whether another pass is useful.

The nonlinear part of the model grows with the square of angles, with the product of an offset and the matrix it is
multiplied by, and with the square of the time offset times the angular acceleration. It is compared with standard
deviations. The one of an offset is taken with all else known, because a weak motion determines offset and matrix
together much less well than each of them alone.
"""

from __future__ import annotations

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.rotation import Array
from kreisel.model.problem import Problem

MIN_INFLATION, MAX_INFLATION = 0.3, 10.0
"""Minimum and maximum factor between the start deviations of a further run and those of the result before it.

The factor is chosen so that the model is linear over the start deviations. In a curved model the estimates must hardly
move during the run. Otherwise the model is linearised at different points, and parameters that are not observable seem
to be observable by the difference. In a linear model large start deviations leave room for offsets with a random walk:
it is not known exactly how much of their start is left at the end.
"""

LINEAR = 0.02
"""Curvature, in deviations of the result, up to which the model counts as linear."""

CURVED = 0.2
"""Curvature, in deviations of the result, above which another pass is useful."""


def linear_inflation(problem: Problem, covariance: Array) -> float:
    """Return the factor on the deviations of a result, of covariance (n, n), over which the model is linear."""
    layout = problem.layout
    deviation, alone = np.sqrt(np.diag(covariance)), deviation_alone(covariance)

    def usual(values: Array, group: str) -> float:
        return float(np.median(values[layout[group]]))

    factors = [MAX_INFLATION]
    for sensor in ("gyro", "accel"):
        matrix, offset = f"{sensor}_cross_coupling", f"{sensor}_offset"
        if matrix in layout:
            factors.append((LINEAR / usual(deviation, matrix)) ** 0.5)
        if matrix in layout and offset in layout:
            product = usual(deviation, matrix) * usual(deviation, offset)
            factors.append((LINEAR * usual(alone, offset) / product) ** 0.5)
    bend = _change_of_rates(problem) * _deviation_of_time(problem, covariance)
    if bend > 0.0:
        factors.append((LINEAR / bend) ** 0.5)
    return max(min(factors), MIN_INFLATION)


def _change_of_rates(problem: Problem) -> float:
    """Return how much of a turn by an error of time is not proportional to it, 1/s: of sin(w t) it is w / 2.

    Half the angular acceleration over the angular rate, both as root mean squares of means between updates.
    """
    readings, start = problem.sensor.readings, problem.prior.start.sensors
    ends = np.unique([update.last for update in problem.schedule.updates])
    seconds = np.diff(readings.stamps[ends])
    sums = np.add.reduceat(readings.rates[: ends[-1]], ends[:-1]) if len(ends) > 1 else np.zeros((0, 3))
    rates = sums / np.diff(ends)[:, None] + start.k_w[0]
    if len(rates) < 2 or not rates.any():
        return 0.0
    changes = np.diff(rates, axis=0) / (0.5 * (seconds[1:] + seconds[:-1]))[:, None]
    return 0.5 * float(np.sqrt(np.mean(changes**2) / np.mean(rates**2)))


def _deviation_of_time(problem: Problem, covariance: Array) -> float:
    """Return the standard deviation of the reference's time in the IMU's, as a root mean square over all updates."""
    layout = problem.layout
    tau = np.array([update.tau for update in problem.schedule.updates])
    by = {g: c for g, c in (("time_offset", np.ones_like(tau)), ("time_skew", tau)) if g in layout}
    if not by:
        return 0.0
    own, columns = [layout[group].start for group in by], np.column_stack(list(by.values()))
    return float(np.sqrt(np.mean(np.sum(columns @ covariance[np.ix_(own, own)] * columns, axis=1))))


def curved(problem: Problem, run: Fit) -> bool:
    """Return whether the model is curved between the start of a run and its result.

    By the square of the change of angles, and by the product of the changes of an offset and its matrix.
    """
    layout, n = problem.layout, len(problem.parameter_names)
    change = np.abs(layout.minus(run.belief.mean[:, None], stored_state(problem, run.start))[:, 0])
    deviation = run.belief.standard_deviation
    alone = deviation_alone(run.belief.covariance[:n, :n])
    angles = [layout[g] for g in ("gyro_cross_coupling", "accel_cross_coupling", "alignment") if g in layout]
    moved = max((float(np.max(change[part])) for part in angles), default=0.0)
    if moved**2 > CURVED * min((float(np.median(deviation[part])) for part in angles), default=np.inf):
        return True
    for sensor in ("gyro", "accel"):
        matrix, offset = f"{sensor}_cross_coupling", f"{sensor}_offset"
        if matrix in layout and offset in layout:
            product = float(np.max(change[layout[matrix]]) * np.max(change[layout[offset]]))
            if product > CURVED * float(np.median(alone[layout[offset]])):
                return True
    return False


def deviation_alone(covariance: Array) -> Array:
    """Return the standard deviation of each parameter with all others known, (n,), from their covariance (n, n)."""
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(deviation / np.sqrt(np.diag(np.linalg.inv(covariance / np.outer(deviation, deviation)))))

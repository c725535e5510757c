"""Attenuation: noise looks like information that the matrices it is multiplied by are small.

The filter knows how an error of K_a changes the velocity: by what the accelerometers read, turned by the attitude it
estimates. It takes both as exact. Their noise enters the innovations by K_a, and the filter sees that they would be
smaller with a smaller K_a: to it the noise is a motion that the reference denies. This is the attenuation of regression
with errors in the variables. In fast motion it is far below the deviations; in weak motion it is several of them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.estimation.uncertainty import Contribution
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import WIDE_GATE, Estimator, Fit
from kreisel.fitting.result_change import regression_on_parameters, result_moved
from kreisel.geometry.rotation import Array, Indices, exp, multiply
from kreisel.model.problem import Problem, with_readings
from kreisel.progress import StepProgress
from kreisel.tasks import Executor, sequential

_NEGLIGIBLE = 0.15
"""Standard deviations; smaller shifts are not worth the passes by which they are computed."""

_MAX = 0.5
"""Largest share of the information about a parameter that is taken for false."""

_HOW_WELL = 0.25
"""Relative deviation of the power of the noise, and so of the shift."""

_MAX_DRAWS = 4
"""Draws of the added noise, each of two passes, with either sign. Chosen: recordings of less than a hundred updates, a
quarter of `_ENOUGH`, do not take more passes."""

_LOCAL = 1.0
"""s; time over which the size of the noise may change."""

_SEED, _ENOUGH = 20_051, 400
"""Of the noise that is added: a result must not depend on chance. Updates over which its products average enough."""

_SHOWN_BY = (np.arange(9), np.array([0, 1, 2, 6, 7, 8]))
"""Rows of the innovations that noise of gyros, and of accelerometers, enters: position, orientation, velocity."""

_MATRICES = {"gyro_cross_coupling": 0, "accel_cross_coupling": 1}
"""The matrices, and whether they multiply the noise of gyros or of accelerometers."""


def pull_of_noise(
    problem: Problem,
    run: Fit,
    estimator: Estimator,
    progress: StepProgress | None = None,
    executor: Executor = sequential,
) -> Array | None:
    """Return by how much as much noise again moves the parameters (n,); None where that is not worth the passes.

    Notes
    -----
    Simulation and extrapolation (Cook and Stefanski 1994), with noise of both signs: what is proportional to the noise
    cancels in the mean of both, and what is proportional to its power is left. Noise that is assumed, but that the
    readings do not have, is not added. The gate is wide: an update that more noise makes it reject moves the parameters
    by more than what is looked for, in recordings of few updates by many deviations.
    """
    worth = (
        g in problem.layout and _bound(problem, run, g, _most(run, _SHOWN_BY[sensor])) > _NEGLIGIBLE
        for g, sensor in _MATRICES.items()
    )  # fmt: skip
    if not any(worth):
        return None
    rng, draws = np.random.default_rng(_SEED), math.ceil(_ENOUGH / len(problem.schedule.updates))
    noisier = [one for _ in range(min(draws, _MAX_DRAWS)) for one in _with_more_noise(problem, rng)]
    refit = partial(estimator.refit, near=run, gate=WIDE_GATE, progress=progress)
    base, *others = executor([partial(refit, one) for one in (problem, *noisier)])
    n = len(problem.parameter_names)
    means = np.column_stack([one.belief.mean for one in others])
    return np.asarray(problem.layout.minus(means, base.belief.mean)[:n].mean(axis=1))


def without_attenuation(problem: Problem, run: Fit, change: Array) -> tuple[Fit, Contribution]:
    """Return a run's result without what noise does to it, and what that adds to its uncertainty.

    Parameters
    ----------
    change : (n,)
        What as much noise again does to the parameters.

    Notes
    -----
    By equation (26). The false information is limited to a share of the whole; the pull is random too, with a variance
    of as much information, and its size is known as well as the power of the noise.
    """
    n = change.size
    P = run.belief.covariance[:n, :n]
    information = np.linalg.inv(P)
    F = _false_information(problem, run, -information @ change)
    F = _false_information(problem, run, pull := -(information @ change + F * change))
    root = np.sqrt(F)
    share = float(np.linalg.eigvalsh(root[:, None] * P * root)[-1])
    if share > _MAX:
        F, pull = (_MAX / share * part for part in (F, pull))
    cleaned = np.linalg.solve(np.eye(n) - P * F, P)  # (I - F)^-1 with I = P^-1
    step = cleaned @ pull
    added = P * F @ cleaned + (cleaned * F) @ cleaned  # (I - F)^-1 - I^-1, and the pull's own variance
    of_size = np.zeros((problem.layout.degrees, 1))
    of_size[:n, 0] = _HOW_WELL * step
    columns = np.hstack([regression_on_parameters(run.belief, n) @ _root(added), of_size])
    return result_moved(problem, run, step), Contribution("attenuation", Source.SENSOR, columns)


def _root(P: Array) -> Array:
    """Return a root (n, k) of a covariance matrix (n, n) of any rank."""
    scale = np.sqrt(np.maximum(np.diag(P), 1e-300))
    values, V = np.linalg.eigh(0.5 * (P + P.T) / np.outer(scale, scale))
    shown = values > 0.0
    return np.asarray(scale[:, None] * V[:, shown] * np.sqrt(values[shown]))


def _false_information(problem: Problem, run: Fit, pull: Array) -> Array:
    """Return the false information about each parameter (n,) that pulls with a gradient (n,) of the likelihood.

    It is the same about all elements of a column of a matrix, which one reading is multiplied by, and it pulls at each
    by as much as its value.
    """
    out = np.zeros(pull.size)
    for group in _MATRICES:
        if group in problem.layout:
            d = problem.layout[group]
            K, own = run.parameters.stored(group).reshape(3, 3), problem.whole(group, pull[d]).reshape(3, 3)
            each = np.tile(np.maximum(np.sum(K * own, axis=0) / np.sum(K**2, axis=0), 0.0), 3)
            out[d] = problem.columns(group, each)
    return out


def _with_more_noise(problem: Problem, rng: np.random.Generator) -> tuple[Problem, Problem]:
    """Return the problem with as much noise again in readings and orientations, and with its opposite."""
    readings, reference = problem.sensor.readings, problem.reference
    interval = float(np.median(np.diff(readings.stamps)))
    width = max(3, round(_LOCAL / interval))
    power = np.minimum(np.square(problem.noise.observed), readings.noise[:2]) / interval
    added = [
        rng.standard_normal(values.shape) * np.sqrt(own * _profile(values, width))
        for values, own in zip((readings.rates, readings.accelerations), power, strict=True)
    ]
    turned = None
    if reference.quaternions is not None:
        moving = np.ones(reference.stamps_ns.size, dtype=bool)
        seconds = problem.schedule.clock.imu_time(reference.seconds)
        for standstill in problem.schedule.standstills:
            moving[np.searchsorted(seconds, standstill.start) : np.searchsorted(seconds, standstill.stop)] = False
        size = problem.noise.reference.orientation * problem.noise.coloured.white_factor
        turned = rng.normal(0.0, size, (moving.size, 3)) * moving[:, None]

    def with_sign(sign: float) -> Problem:
        noisy = readings.with_values(
            rates=readings.rates + sign * added[0], accelerations=readings.accelerations + sign * added[1]
        )
        if turned is None or reference.quaternions is None:
            return with_readings(problem, noisy)
        moved = replace(reference, quaternions=multiply(reference.quaternions, exp(sign * turned)))
        return replace(with_readings(problem, noisy), reference=moved)

    return with_sign(1.0), with_sign(-1.0)


def _profile(values: Array, width: int) -> Array:
    """Return the power of the noise in readings (n, 3) over time, one on average: by third differences."""
    squares = np.zeros_like(values)
    squares[3:] = np.diff(values, n=3, axis=0) ** 2
    summed = np.cumsum(np.vstack([np.zeros(3), squares]), axis=0)
    i = np.arange(len(values))
    low, high = np.maximum(i - width // 2, 0), np.minimum(i + width // 2 + 1, len(values))
    local = (summed[high] - summed[low]) / (high - low)[:, None]
    return np.asarray(local / np.maximum(local.mean(axis=0), 1e-300))


def _most(run: Fit, rows: Indices) -> float:
    """Return an upper bound of the false information that some rows of the innovations contain.

    The share of their variance that is not the reference's noise: residuals after an update are the innovations times
    the other share.
    """
    innovation, residual = (part[:, rows] for part in (run.history.innovation, run.history.residual))
    seen = ~np.isnan(innovation)
    squares = float(np.sum(innovation[seen] ** 2))
    share = 1.0 - float(np.sum(innovation[seen] * residual[seen])) / squares if squares > 0.0 else 0.0
    return max(share, 0.0) * float(np.sum(seen)) / 3.0


def _bound(problem: Problem, run: Fit, group: str, size: float) -> float:
    """Return how far so much false information about each element of a matrix moves any parameter, in deviations."""
    lasting = problem.lasting
    pull = run.belief.covariance[np.ix_(lasting, np.r_[problem.layout[group]])] @ problem.stored(run.parameters, group)
    return size * float(np.max(np.abs(pull) / run.belief.standard_deviation[lasting]))

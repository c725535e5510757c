"""Attenuation: noise of the readings looks like information that the matrices they are multiplied by are small.

The filter knows how an error of K_a changes the velocity: by what the accelerometers read. It takes these readings as
exact. Their noise enters the innovations by K_a, and the filter sees that they would be smaller with a smaller K_a: to
it the noise is a motion that the reference denies. This is the attenuation of regression with errors in the variables.
In fast motion it is far below the deviations; in weak motion it is several of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from kreisel.filtering.history import FilterRun, Pass
from kreisel.filtering.noise_adaptation import imu_density
from kreisel.filtering.result_change import result_moved
from kreisel.geometry.rotation import Indices
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress, Together, one_by_one

_NEGLIGIBLE = 0.15
"""Standard deviations; smaller shifts are not worth the passes by which they are computed."""

_STEP = 0.05
"""Relative change of the noise by which the innovations' share of it is found."""

_MOST = 0.5
"""Largest share of the information about a parameter that is taken for false."""

_SHOWN_BY = (np.arange(9), np.array([0, 1, 2, 6, 7, 8]))
"""Rows of the innovations that noise of gyros, and of accelerometers, enters: position, orientation, velocity."""

_MATRICES = {"gyro_cross_coupling": 0, "accel_cross_coupling": 1}
"""The matrices, and whether they multiply the noise of gyros or of accelerometers."""


def false_information(
    problem: Problem,
    run: FilterRun,
    further_pass: Pass,
    progress: StepProgress | None = None,
    together: Together = one_by_one,
) -> dict[str, float]:
    """Return the false information that noise adds about every element of each matrix; empty where it does not matter.

    Notes
    -----
    With innovations nu of covariance S and their derivative N by an element, the part of N that is noise gives
    E[N^T S^-1 N] information and E[N^T S^-1 nu] pull. Both equal the innovations' share of that noise, and this is half
    the derivative of ln det S by the logarithm of its standard deviation: gains are optimal, so their change has no
    effect. A unit of noise moves every axis alike, so each of the three columns has a third. Noise that is assumed, but
    that the readings do not have, does not pull.
    """
    wanted = [
        g for g, sensor in _MATRICES.items()
        if g in problem.layout and _pull(problem, run, g, _most(run, _SHOWN_BY[sensor])) > _NEGLIGIBLE
    ]  # fmt: skip
    if not wanted:
        return {}
    noisier = [
        replace(problem, readings=problem.readings.with_noise(*(1.0 + _STEP * (i == _MATRICES[g]) for i in range(2))))
        for g in wanted
    ]
    works = [partial(further_pass, one, run, progress=progress) for one in (problem, *noisier)]
    base, *others = (_log_determinants(one) for one in together(works))
    out = {}
    for group, changed in zip(wanted, others, strict=True):
        sensor = _MATRICES[group]
        there = min(1.0, problem.noise.observed[sensor] / imu_density(problem)[sensor]) ** 2
        out[group] = there * max(0.0, changed - base) / (2.0 * np.log1p(_STEP)) / 3.0
    return out


def _most(run: FilterRun, rows: Indices) -> float:
    """Return an upper bound of the false information that some rows of the innovations contain.

    The share of their variance that is not the reference's noise: residuals after an update are the innovations times
    the other share.
    """
    innovation, residual = (part[:, rows] for part in (run.history.innovation, run.history.residual))
    seen = ~np.isnan(innovation)
    squares = float(np.sum(innovation[seen] ** 2))
    share = 1.0 - float(np.sum(innovation[seen] * residual[seen])) / squares if squares > 0.0 else 0.0
    return max(share, 0.0) * float(np.sum(seen)) / 3.0


def _pull(problem: Problem, run: FilterRun, group: str, size: float) -> float:
    """Return how far so much false information about each element of a matrix moves any parameter, in deviations."""
    lasting = problem.lasting
    pull = run.belief.covariance[np.ix_(lasting, np.r_[problem.layout[group]])] @ run.parameters.stored(group)
    return size * float(np.max(np.abs(pull) / run.belief.standard_deviation[lasting]))


def without_attenuation(problem: Problem, run: FilterRun, false: Mapping[str, float]) -> FilterRun:
    """Return a run's result without false information, as if it had measured that the matrices are zero.

    Notes
    -----
    The shift of equation (26). The pull is random too: its variance is that of as much information.
    """
    false = {group: size for group, size in false.items() if group in problem.layout and size > 0.0}
    if not false:
        return run
    n = len(problem.parameter_names)
    P = run.belief.covariance[:n, :n]
    F, value = np.zeros(n), np.zeros(n)
    for group, size in false.items():
        F[problem.layout[group]] = size
        value[problem.layout[group]] = run.parameters.stored(group)
    root = np.sqrt(F)
    share = float(np.linalg.eigvalsh(root[:, None] * P * root)[-1])
    F *= min(1.0, _MOST / share)
    # (I - F)^-1 with I = P^-1
    cleaned = np.linalg.solve(np.eye(n) - P * F, P)
    step = cleaned @ (F * value)
    return result_moved(problem, run, step, np.asarray(cleaned + (cleaned * F) @ cleaned))


def _log_determinants(run: FilterRun) -> float:
    """Return the sum of the logarithms of the determinants of the innovations' covariances."""
    return float(-2.0 * np.sum(run.history.log_likelihood + 0.5 * run.history.nis))

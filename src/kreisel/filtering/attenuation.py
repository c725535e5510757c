"""Attenuation: noise of the readings looks like information that the matrices they are multiplied by are small.

The filter knows how an error of K_a changes the velocity: by what the accelerometers read. It takes these readings as
exact. Their noise enters the innovations by K_a, and the filter sees that they would be smaller with a smaller K_a: to
it the noise is a motion that the reference denies. This is the attenuation of regression with errors in the variables.
In fast motion it is far below the deviations; in weak motion it is several of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kreisel.filtering.history import FilterRun, Pass
from kreisel.filtering.noise_adaptation import imu_density
from kreisel.filtering.result_change import result_moved
from kreisel.model.problem import Problem
from kreisel.progress import StepProgress

_NEGLIGIBLE = 0.1
"""Standard deviations; smaller shifts are not worth the passes by which they are computed."""

_STEP = 0.05
"""Relative change of the noise by which the innovations' share of it is found."""

_MOST = 0.5
"""Largest share of the information about a parameter that is taken for false."""

_MATRICES = {"gyro_cross_coupling": 0, "accel_cross_coupling": 1}
"""The matrices, and whether they multiply the noise of gyros or of accelerometers."""


def false_information(
    problem: Problem, run: FilterRun, further_pass: Pass, progress: StepProgress | None = None
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
    history, deviation = run.history, run.belief.standard_deviation
    # no noise of the IMU has a larger share than all but the reference's noise
    most = _log_determinants(run) - float(np.nansum(np.log(history.noise_variance))) if len(history.nis) else 0.0
    wanted = [g for g in _MATRICES if g in problem.layout]
    wanted = [g for g in wanted if most / 3.0 * float(deviation[problem.layout[g]].max()) > _NEGLIGIBLE]
    if not wanted:
        return {}
    base = _log_determinants(further_pass(problem, run, progress=progress))
    out = {}
    for group in wanted:
        sensor = _MATRICES[group]
        noisier = problem.readings.with_noise(*(1.0 + _STEP * (i == sensor) for i in range(2)))
        changed = _log_determinants(further_pass(replace(problem, readings=noisier), run, progress=progress))
        there = min(1.0, problem.noise.observed[sensor] / imu_density(problem)[sensor]) ** 2
        out[group] = there * max(0.0, changed - base) / (2.0 * np.log1p(_STEP)) / 3.0
    return out


def without_attenuation(problem: Problem, run: FilterRun, false: Mapping[str, float]) -> FilterRun:
    """Return a run's result without false information, as if it had measured that the matrices are zero.

    Notes
    -----
    Equation (26). The pull is random too: its variance is that of as much information.
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

"""How much of the variance of each parameter comes from the reference's noise: by adjoint, exactly for a linear model.

The error of the estimate is a sum of independent errors, each times its derivative; one recursion back over the slopes
of a run gives the derivatives of all parameters by all of them.
"""

from __future__ import annotations

import numpy as np

from kreisel._kernels.slope_recursions import carry_back
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import Fit
from kreisel.geometry.rotation import Array
from kreisel.kalman.elimination import Elimination
from kreisel.kalman.run_slopes import Slopes
from kreisel.model.problem import Problem

_PARTS = (("standstill_position", "path_position"), ("standstill_orientation", "path_orientation"))
"""States of the reference's error, for positions and orientations."""


def variance_of_reference(problem: Problem, run: Fit, slopes: Slopes, known: Elimination) -> dict[Source, Array]:
    """Return the variances of all parameters (n,) by the reference's noise on the path, at standstill, and of an arm.

    Components of a measurement's noise count as independent.

    Notes
    -----
    The recursion of equation (30), with the last estimates themselves in the place of the log-likelihood.
    """
    layout, noise, n = problem.layout, problem.noise, known.scale.size
    still, measured = run.history.at_standstill, np.nan_to_num(run.history.noise_variance)
    coloured, starts = noise.coloured, slopes.starts
    of_arm = np.array([noise.pose_error.position, noise.pose_error.orientation]) ** 2
    at_rest = np.array(noise.at_rest) ** 2
    in_motion = np.array([coloured.position, coloured.orientation]) ** 2 - of_arm
    out = {Source.PATH: np.zeros(n), Source.STANDSTILL: np.zeros(n), Source.ROBOT: np.zeros(n)}
    exchange = np.linalg.solve(known.information, known.run)
    derivatives = np.zeros((slopes.degrees, n))
    derivatives[:n] = (known.scale[:, None] * exchange / known.scale).T
    groups = [group for kind in _PARTS for group in kind if group in layout]
    places = {group: slice(3 * i, 3 * i + 3) for i, group in enumerate(groups)}
    degrees = np.array([d for group in groups for d in range(layout[group].start, layout[group].stop)], dtype=np.int64)
    for stretch in reversed([*slopes.stretches()]):
        own = stretch.numbers
        weights = np.zeros((len(stretch.used), stretch.whitening.shape[1], n))
        after, before = carry_back(stretch.tables, weights, derivatives, after=degrees, before=degrees)
        by_measured = -(stretch.whitening.swapaxes(1, 2) @ weights)
        for source, which in ((Source.STANDSTILL, still[own]), (Source.PATH, ~still[own])):
            out[source] += np.einsum("ui,uin->n", measured[own][which], by_measured[which] ** 2)
        begins = slopes.new_standstill[own].copy()
        begins[: 1 if own.start == 0 else 0] = True
        for kind, (at_standstill, on_path) in enumerate(_PARTS):
            if at_standstill in places:
                squares = np.sum(before[begins, places[at_standstill]] ** 2, axis=(0, 1))
                out[Source.STANDSTILL] += at_rest[kind] * squares
                out[Source.ROBOT] += of_arm[kind] * squares
            if on_path in places:
                ended = after[:, places[on_path]]
                # at standstill it is not a part of what is measured
                ended -= np.where(still[own, None, None], 0.0, by_measured[:, 3 * kind : 3 * kind + 3])
                fresh = -np.expm1(-2.0 * slopes.seconds[own] / coloured.time)
                squares = fresh @ np.sum(ended**2, axis=1)
                squares += np.sum(before[starts[own], places[on_path]] ** 2, axis=(0, 1))
                out[Source.PATH] += in_motion[kind] * squares
                out[Source.ROBOT] += of_arm[kind] * squares
    return out

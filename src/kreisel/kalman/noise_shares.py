"""How much of the variance of each parameter comes from the reference's noise: by adjoint, exactly for a linear model.

The error of the estimate is a sum of independent errors, each times its derivative; one recursion back over the slopes
of a run gives the derivatives of all parameters by all of them.
"""

from __future__ import annotations

import numpy as np

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
    after = np.zeros((slopes.degrees, n))
    after[:n] = (known.scale[:, None] * exchange / known.scale).T
    moving = slopes.moving
    for slope in reversed(slopes):
        i = slope.number
        by_whitened = slope.gain @ after
        by_measured = slope.whitening.T @ by_whitened
        source = Source.STANDSTILL if still[i] else Source.PATH
        out[source] += measured[i] @ by_measured**2
        before = slope.slopes.T @ np.vstack([after[moving], -by_whitened])
        before[: moving.start] += after[: moving.start]
        for kind, (at_standstill, on_path) in enumerate(_PARTS):
            if at_standstill in layout and (slopes.new_standstill[i] or i == 0):
                squares = np.sum(before[layout[at_standstill]] ** 2, axis=0)
                out[Source.STANDSTILL] += at_rest[kind] * squares
                out[Source.ROBOT] += of_arm[kind] * squares
            if on_path in layout:
                ended = after[layout[on_path]]
                if not still[i]:  # at standstill it is not a part of what is measured
                    ended = ended - by_measured[3 * kind : 3 * kind + 3]
                fresh = -np.expm1(-2.0 * slopes.seconds[i] / coloured.time)
                squares = fresh * np.sum(ended**2, axis=0)
                if i in starts:
                    squares += np.sum(before[layout[on_path]] ** 2, axis=0)
                out[Source.PATH] += in_motion[kind] * squares
                out[Source.ROBOT] += of_arm[kind] * squares
        slopes.between(i, before)
        after = before
    return out

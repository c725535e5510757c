"""Exchange of the prior of a run: the run starts with a narrow prior, its result contains the stated one.

Sigma points stay where the model is nearly linear if a run starts near the estimate, with deviations of about the
size they have at its end. Such a start is a prior that nobody stated. Parameters do not change during a run, so its
information is a part of the result's. After the run it is subtracted, and the information of the stated prior is
added. Only the point about which the model was linearised still depends on the narrow prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.fitting.fit import Fit
from kreisel.fitting.nonlinearity import linear_inflation
from kreisel.fitting.result_change import result_moved
from kreisel.fitting.stored_state import first_belief
from kreisel.geometry.rotation import Array, Indices
from kreisel.kalman.elimination import Elimination
from kreisel.model.parameters import PASSING_GROUPS, CellParameters
from kreisel.model.problem import Problem, with_nominal


def narrowed_belief(problem: Problem, run: Fit) -> Belief:
    """Return the start belief of a further run: the last result with inflated deviations, within the prior.

    Offsets that walk begin with the prior itself. What a run says of their end cannot be told from what a narrow belief
    said of their beginning: it would be counted as data, most of all for error terms that are nearly offsets.
    """
    belief = first_belief(problem, start_near(problem, run), problem.prior.covariance)
    lasting = problem.lasting
    if lasting.size == 0:
        return belief
    i = np.ix_(lasting, lasting)
    prior = (belief.factor @ belief.factor.T)[i]
    covariance = run.belief.covariance[i]
    n = len(problem.parameter_names)
    found = linear_inflation(problem, run.belief.covariance[:n, :n]) ** 2 * covariance
    # P = (A^-1 + B^-1)^-1 = A (A + B)^-1 B, scaled by about its own deviations
    a, b = np.diag(prior), np.diag(found)
    scale = np.sqrt(a * b / (a + b))
    A, B = (M / np.outer(scale, scale) for M in (prior, found))
    P = A @ np.linalg.solve(A + B, B)
    walking = np.isin(lasting, _walking_offsets(problem))
    P[walking], P[:, walking] = 0.0, 0.0
    P[np.ix_(walking, walking)] = A[np.ix_(walking, walking)]
    factor = belief.factor.copy()
    factor[i] = scale[:, None] * np.linalg.cholesky(0.5 * (P + P.T) + 1e-15 * np.diag(np.diag(P)))
    return Belief(belief.mean, factor)


def _walking_offsets(problem: Problem) -> Indices:
    """Return the degrees of freedom of sensors' offsets that walk."""
    density, layout = problem.noise.offset_walk, problem.layout
    own = [g for g in ("gyro_offset", "accel_offset") if density.get(g, 0.0) > 0.0 and g in layout]
    return np.concatenate([np.zeros(0, dtype=np.int64), *(np.arange(layout[g].start, layout[g].stop) for g in own)])


def start_near(problem: Problem, run: Fit) -> CellParameters:
    """Return a run's result as the start of a further one: nothing is left of what passes."""
    return with_nominal(problem, run.parameters, PASSING_GROUPS)


def with_stated_prior(problem: Problem, run: Fit, begun: Belief) -> Fit:
    """Return a run whose result contains the problem's prior instead of the belief it started with.

    Parameters
    ----------
    begun
        The belief the run started with.

    Notes
    -----
    With information matrices of the result I, of the start belief B and of the prior A, and the distances b and a of
    the centres of the latter two from the result: the new information is I - B + A, the new mean lies (I - B + A)^-1
    (A a - B b) away. An offset with a random walk changes during the run; B and A are then those of the start with the
    walk's variance added, which is at most what the result contains of them.
    """
    if not problem.parameter_names:
        return run
    known = elimination(problem, run, begun)
    scale, P, _, I_begun, I_prior, to_begun, to_prior = known
    size = np.outer(scale, scale)
    information = known.information
    fitted = max(0.0, float(np.trace((I_begun - I_prior) @ P)))
    noise = _information_of_noise(problem, run, scale)
    damped = _limited(0.5, noise, information)
    # equation (21)
    step = np.linalg.solve(information - damped, I_prior @ to_prior - (I_begun + damped) @ to_begun)
    noise = _limited(0.9, noise, information)
    P_new = np.linalg.inv(information - noise)
    moved = result_moved(problem, run, scale * step, (P_new + P_new @ noise @ P_new) * size)
    return replace(moved, fitted=fitted)


def elimination(problem: Problem, run: Fit, begun: Belief) -> Elimination:
    """Return the information of a run, of the belief it started with, and of the problem's prior."""
    layout, n = problem.layout, len(problem.parameter_names)
    covariance = run.belief.covariance
    scale = np.sqrt(np.diag(covariance)[:n])
    size, walk = np.outer(scale, scale), np.diag((1 + run.jumps) * problem.walked_variance)
    prior = first_belief(problem, problem.prior.value, problem.prior.covariance)
    P = covariance[:n, :n] / size
    I_run, I_begun, I_prior = (
        np.linalg.inv(M) for M in (P, _start(begun, n, walk) / size, _start(prior, n, walk) / size)
    )
    to_begun, to_prior = (layout.minus(other.mean[:, None], run.belief.mean)[:n, 0] / scale for other in (begun, prior))
    return Elimination(scale, P, I_run, I_begun, I_prior, to_begun, to_prior)


def _information_of_noise(problem: Problem, run: Fit, scale: Array) -> Array:
    """Return the false part of the information (n, n), scaled, that noise of the rates adds about the clocks.

    A pose is extrapolated to its own time with the last reading of the rate. In a slow motion the noise of that
    reading is as large as the rate or larger, and the filter counts its square as information about the time offset.
    It is not information: it only adds noise to the estimate.
    """
    out = np.zeros((scale.size, scale.size))
    if "time_offset" not in problem.layout:
        return out
    K = run.parameters.sensors.K_omega
    variance = problem.noise.rate_scatter**2 * float(np.sum(K**2)) / 3.0
    i = problem.layout["time_offset"].start
    out[i, i] = variance * float(np.sum(run.history.turn_information)) * scale[i] ** 2
    return out


def _limited(share: float, part: Array, information: Array) -> Array:
    """Return a part of an information matrix, one number on its diagonal, limited to a share of the whole."""
    i = int(np.argmax(np.diag(part)))
    most = share / float(np.linalg.inv(information)[i, i])
    return part * min(1.0, most / max(float(part[i, i]), 1e-300))


def _start(belief: Belief, n: int, walk: Array) -> Array:
    """Return a belief's covariance of the parameters (n, n), with the variance of the offsets' walk added."""
    return np.asarray(belief.factor[:n, :n] @ belief.factor[:n, :n].T + walk)

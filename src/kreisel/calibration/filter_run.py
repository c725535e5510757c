"""One run of the filter over a recording, and what it leaves for judging it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from kreisel._kernels import filtering
from kreisel.calibration.cell_model import filter_model, filter_record, filter_steps
from kreisel.calibration.parameters import GROUPS, CellParameters
from kreisel.calibration.problem import Problem, Update
from kreisel.errors import EstimationError
from kreisel.estimation.consistency import gate as gate_at
from kreisel.estimation.filter import Belief, renew
from kreisel.geometry.rotation import Array, apply, conjugate, exp, log, multiply
from kreisel.inertial.readings import attitudes_at
from kreisel.inertial.strapdown import SensorColumns
from kreisel.recording import ReferencePoses

GATE = 1e-6
"""A measurement less probable than one in a million is rejected."""

MOST_IN_A_ROW = 6
"""After so many rejected in a row the estimate, not the measurement, is taken to be wrong."""

_FIRST_ATTITUDE, _FIRST_POSITION, _FIRST_VELOCITY = 0.02, 0.02, 0.3
"""Standard deviations (rad, m, m/s) navigation begins with; wide, since the first pose is used again."""

_BLIND_VELOCITY = 1.0
"""m/s; where the reference does not show it."""

_MOST_AT_ONCE = 256
"""Updates between two reports of progress, at most."""

_MOST_IN_A_PART = 4096
"""Updates prepared and looked back at together: what they need in between takes twice what is kept of them."""

_LOOKED_BACK = 0.01
"""rad; how well attitudes are known once the rates are integrated back from the end of a run."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class History:
    """What happened at every update; the first axis counts updates.

    Attributes
    ----------
    seconds
        IMU seconds.
    parameters, deviations : (u, parameters)
        Estimates and standard deviations; those of the alignment are distances from the last.
    at_rest, used
        Kind of update, and whether it passed the gate.
    nis, degrees
        Normalised innovation squared, and the degrees of freedom it is expected to equal.
    log_likelihood
        Of each innovation.
    whitened, innovation, residual : (u, 9)
        Innovation divided by its factor; innovation; innovation left after the update. Position,
        orientation, velocity; nan where there is no such measurement.
    noise_variance : (u, 9)
        The measurement noise believed in, along the diagonal.
    correction, correction_variance : (u, 6)
        Change of velocity and attitude by the update, and the variance the filter expected of it.
    turn_information
        What an update says of a turn about any axis, the sum over the three: trace of the inverse covariance of
        innovations in orientation, rad^-2; 0 where it was rejected or there is no such measurement.
    """

    seconds: Array
    parameters: Array
    deviations: Array
    at_rest: np.ndarray[tuple[int], np.dtype[np.bool_]]
    used: np.ndarray[tuple[int], np.dtype[np.bool_]]
    nis: Array
    degrees: Array
    log_likelihood: Array
    whitened: Array
    innovation: Array
    residual: Array
    noise_variance: Array
    correction: Array
    correction_variance: Array
    turn_information: Array


@dataclass(frozen=True)
class FilterRun:
    """Result of one run: what it started from, final belief, parameters in it, history.

    `fitted` is the number of parameters that were fitted to the same data before the run began: the innovations are
    smaller by so many degrees of freedom.
    """

    start: CellParameters
    belief: Belief
    parameters: CellParameters
    history: History
    fitted: float = 0.0

    @property
    def excess(self) -> float:
        """Factor on normalised innovations squared for the degrees of freedom fitted before; 1 where none were."""
        degrees = float(np.sum(self.history.degrees[self.history.used]))
        return degrees / max(degrees - self.fitted, 0.3 * degrees, 1.0) if degrees > 0.0 else 1.0


def named(progress: Callable[[str, float], None] | None, name: str) -> Progress | None:
    """Return a report of progress under a step's name."""
    return None if progress is None else lambda share: progress(name, share)


def stored_state(problem: Problem, parameters: CellParameters) -> Array:
    """Return the stored state (size,) with these parameters, all else zero and unturned."""
    x = np.zeros(problem.layout.size)
    x[problem.layout.stored("attitude")] = (1.0, 0.0, 0.0, 0.0)
    for group in problem.groups:
        x[problem.layout.stored(group)] = parameters.stored(group)
    return x


def first_belief(problem: Problem, start: CellParameters, covariance: dict[str, Array] | None = None) -> Belief:
    """Return the belief before the first update: parameters at `start` with the covariance of each group.

    By default that of the problem's own start.
    """
    covariance = problem.start_covariance if covariance is None else covariance
    layout = problem.layout
    mean = stored_state(problem, start)
    factor = np.zeros((layout.degrees, layout.degrees))
    for part in layout:
        if part.name in covariance:
            d = layout[part.name]
            factor[d, d] = np.linalg.cholesky(covariance[part.name])
    others = {"attitude": _FIRST_ATTITUDE, "velocity": _FIRST_VELOCITY, "position": _FIRST_POSITION}
    if "rest_position" in layout:
        others["rest_position"], others["rest_orientation"] = problem.rest_error
    if problem.lasting.time > 0.0:
        lasting = {"path_position": problem.lasting.position, "path_orientation": problem.lasting.orientation}
        others |= {name: size for name, size in lasting.items() if name in layout}
    for name, deviation in others.items():
        factor[layout[name], layout[name]] = deviation * np.eye(3)
    return Belief(mean, factor)


def run_filter(
    problem: Problem,
    start: CellParameters,
    *,
    gate: float = 1.0,
    progress: Progress | None = None,
    belief: Belief | None = None,
) -> FilterRun:
    """Return the result of running the filter over all updates of a problem.

    Parameters
    ----------
    start
        First values of the estimated groups, and values of those that are not.
    gate
        Factor on the innovation's bound; above 1 where the believed noise is known to be too small.
    progress
        Called with the share done.

    Raises
    ------
    EstimationError
        If the state stops being finite; says when.
    """
    updates, model = problem.updates, filter_model(problem, start)
    belief = first_belief(problem, start) if belief is None else belief
    bounds = np.array([0.0, *(gate * gate_at(GATE, m) for m in range(1, filtering.MEASURED + 1))])
    rejected, histories = np.zeros(1, dtype=np.int64), []
    for begin in range(0, len(updates), _MOST_IN_A_PART):
        some = slice(begin, min(begin + _MOST_IN_A_PART, len(updates)))
        steps, record = filter_steps(problem, updates[some]), filter_record(problem, some.stop - some.start)
        done = begin
        while done < some.stop:
            belief = _belief_before(problem, start, belief, done, rejected)
            mean, upper = belief.mean.copy(), belief.factor.T.copy()
            signal, until = problem.readings.holding(updates[done].first, updates[done].last)
            counted = steps._replace(first=steps.first - signal.begin, last=steps.last - signal.begin)
            done = begin + filtering.run(
                model, signal.samples, counted, done - begin, _next_event(updates, done, some.stop, until) - begin,
                bounds, MOST_IN_A_ROW, mean, upper, record, rejected,
            )  # fmt: skip
            belief = Belief(mean, upper.T.copy())
            if not np.isfinite(record.whitened[done - 1 - begin]).all():
                raise EstimationError(
                    f"the filter's state is no longer finite at {problem.readings.stamps[updates[done - 1].last]:.2f} "
                    "s; check units and noise figures, or fix groups the motion does not show"
                )
            if progress is not None:
                progress(done / len(updates))
        histories.append(_history(problem, updates[some], record))
    history = _joined(problem, histories, belief.mean)
    return FilterRun(start, belief, _parameters(problem, start, belief.mean), history)


def _belief_before(
    problem: Problem, start: CellParameters, belief: Belief, at: int, rejected: NDArray[np.int64]
) -> Belief:
    """Return the belief before an update that begins navigation anew, or a rest."""
    item = problem.updates[at]
    if item.new_segment or rejected[0] >= MOST_IN_A_ROW:
        belief = _navigation_from_reference(problem, start, belief, at)
        rejected[0] = 0
    if item.new_rest and "rest_position" in problem.layout:
        belief = _renew_rest(problem, belief)
    return belief


def _next_event(updates: tuple[Update, ...], at: int, stop: int, until: int) -> int:
    """Return the next update before which the belief changes by other means, or progress should show.

    It is update `stop` at the latest, or one behind sample `until`, up to which the readings are made ready.
    """
    stop = min(at + _MOST_AT_ONCE, stop)
    for i in range(at + 1, stop):
        if updates[i].new_segment or updates[i].new_rest or updates[i].last > until:
            return i
    return stop


def _parameters(problem: Problem, known: CellParameters, x: Array) -> CellParameters:
    """Return the parameters in a stored state (size,), and known ones for groups that are not in it."""
    layout = problem.layout
    return CellParameters.from_stored(
        {group: (x[layout.stored(group)] if group in layout else known.stored(group)).copy() for group in GROUPS}
    )


def _navigation_from_reference(problem: Problem, known: CellParameters, belief: Belief, at: int) -> Belief:
    """Begin navigation anew at the sample an update starts from: its own, or that of the one before."""
    layout, reference, item = problem.layout, problem.reference, problem.updates[at]
    attitude = problem.attitude[at if item.first == item.last else at - 1]
    t = problem.readings.stamps[item.first]
    parameters = _parameters(problem, known, belief.mean)
    tau = (t - parameters.start) / (1.0 + parameters.skew)
    q, p, v = pose_near(reference, problem.tau, tau)
    turned, blind = reference.quaternions is not None, reference.positions is None
    for name, value, deviation in (
        ("attitude", q if turned else attitude, _FIRST_ATTITUDE if turned else problem.attitude_sd),
        ("velocity", v, _BLIND_VELOCITY if blind else _FIRST_VELOCITY),
        ("position", p, _FIRST_POSITION),
    ):
        belief = renew(layout, belief, name, value, np.full(3, deviation))
    return belief


def look_back(problem: Problem, run: FilterRun) -> Problem:
    """Return the problem with attitudes integrated back from the end of a run, where the reference shows none.

    A run that begins with a guess of the attitude is nonlinear until it has found it; the next one need not
    guess. With gaps in the readings nothing can be carried over, and the problem is returned as it is.
    """
    readings = problem.readings
    if problem.reference.quaternions is not None or len(readings.segments) > 1:
        return problem
    p, samples = run.parameters, np.array([item.last for item in problem.updates])
    columns = SensorColumns.single(p.sensors, problem.settings.size_effect)
    free = attitudes_at(readings, columns.rate[..., 0], samples)
    level, down = problem.site.earth_rate_units
    earth = apply(p.q_rn, np.array([*(level * p.north), down * p.earth_down]))
    turned = exp(-(readings.stamps[samples] - readings.stamps[samples[-1]])[:, None] * earth)
    at_end = multiply(run.belief.mean[problem.layout.stored("attitude")], conjugate(free[-1]))
    return replace(problem, attitude=multiply(turned, multiply(at_end, free)), attitude_sd=_LOOKED_BACK)


def pose_near(reference: ReferencePoses, tau: Array, at: float) -> tuple[Array, Array, Array]:
    """Return attitude, position and velocity at a reference time, by a line through the poses around it."""
    k = int(np.clip(np.searchsorted(tau, at) - 1, 0, tau.size - 2))
    width = max(1, round(0.05 / float(np.median(np.diff(tau)))))
    low, high = max(k - width + 1, 0), min(k + width, tau.size - 1)
    share = (at - tau[k]) / (tau[k + 1] - tau[k])
    q, p, v = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    if reference.positions is not None:
        p = (1.0 - share) * reference.positions[k] + share * reference.positions[k + 1]
        v = (reference.positions[high] - reference.positions[low]) / (tau[high] - tau[low])
    if reference.quaternions is not None:
        turned = log(multiply(conjugate(reference.quaternions[k]), reference.quaternions[k + 1]))
        q = multiply(reference.quaternions[k], exp(share * turned))
    return q, p, v


def _renew_rest(problem: Problem, belief: Belief) -> Belief:
    for name, deviation in zip(("rest_position", "rest_orientation"), problem.rest_error, strict=True):
        belief = renew(problem.layout, belief, name, np.zeros(3), np.full(3, deviation))
    return belief


def _history(problem: Problem, updates: Sequence[Update], record: filtering.Record) -> History:
    """Return what happened at some updates, with stored parameters for estimates."""
    at_rest = np.array([item.rest is not None for item in updates])
    reference = problem.reference
    given = [reference.positions is not None, reference.quaternions is not None]
    n = len(updates)
    degrees, nis, log_likelihood = np.empty(n), np.empty(n), np.empty(n)
    wide = np.full((4, n, filtering.MEASURED), np.nan)
    correction, variance, information = np.empty((n, 6)), np.empty((n, 6)), np.zeros(n)
    for resting in (False, True):
        which = np.flatnonzero(at_rest == resting)
        if which.size == 0:
            continue
        present = np.flatnonzero(np.repeat([*given, resting], 3))
        m = present.size
        S, R, gain = record.factor[which, :m, :m], record.noise[which, :m, :m], record.gain[which, :, :m]
        white, innovation = record.whitened[which, :m], record.innovation[which, :m]
        # what is left of an innovation: the noise's covariance times the inverse of the innovation's
        solved = np.linalg.solve(np.swapaxes(S, 1, 2), white[..., None])
        parts = (white, innovation, (R @ solved)[..., 0], np.diagonal(R, axis1=1, axis2=2))
        for row, part in zip(wide, parts, strict=True):
            row[np.ix_(which, present)] = part
        degrees[which] = m
        nis[which] = np.sum(white**2, axis=1)
        log_likelihood[which] = -0.5 * nis[which] - np.log(np.diagonal(S, axis1=1, axis2=2)).sum(axis=1)
        correction[which] = (gain @ white[..., None])[..., 0]
        variance[which] = np.sum(gain**2, axis=2)
        turns = np.flatnonzero((present >= 3) & (present < 6))
        if turns.size:
            inverse = np.linalg.inv(S)[:, :, turns]
            information[which] = record.used[which] * np.sum(inverse**2, axis=(1, 2))
    stored = [problem.layout.stored(group) for group in problem.groups]
    kept = record.mean[:, : max((part.stop for part in stored), default=0)].copy()
    seconds = problem.readings.stamps[[item.last for item in updates]]
    return History(
        seconds, kept, record.deviation, at_rest, record.used, nis, degrees, log_likelihood,
        wide[0], wide[1], wide[2], wide[3], correction, variance, information,
    )  # fmt: skip


def _joined(problem: Problem, parts: Sequence[History], last: Array) -> History:
    """Return the histories of all parts as one, its estimates one number for each degree of freedom.

    Those of the alignment are distances from the last, the stored state (size,).
    """
    columns = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(History)}
    layout, stored, out = problem.layout, columns["parameters"], []
    for group in problem.groups:
        value = stored[:, layout.stored(group)]
        if group == "alignment":
            turned = log(multiply(conjugate(last[layout.stored(group)]), value))
            value = turned[:, : layout[group].stop - layout[group].start]
        out.append(value)
    columns["parameters"] = np.hstack(out) if out else np.empty((len(stored), 0))
    return History(**columns)

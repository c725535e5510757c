"""One run of the filter over all updates of a problem."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping

import numpy as np
from numpy.typing import NDArray

from kreisel._kernels import filter_arguments
from kreisel._kernels.filter import run
from kreisel.errors import EstimationError
from kreisel.estimation.belief import Belief, inflate_variance
from kreisel.estimation.consistency import GATE, MAX_REJECTED_IN_A_ROW, chi_square_bound
from kreisel.fitting.fit import Fit
from kreisel.fitting.reported_poses import pose_regressor
from kreisel.fitting.stored_state import first_belief, parameters_of
from kreisel.geometry.rotation import Array
from kreisel.kalman.kernel_inputs import effect_sizes, filter_model, filter_record, filter_steps, reference_groups
from kreisel.kalman.navigation_start import navigation_from_reference
from kreisel.kalman.run_slopes import Slopes
from kreisel.kalman.update_record import history_of, joined
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem, walked_variance
from kreisel.model.schedule import Update
from kreisel.progress import StepProgress

_MAX_BETWEEN_REPORTS = 1024
"""Updates between two reports of progress, at most."""

_CHUNK = 4096
"""Updates prepared and recorded together; their working arrays take twice the memory of what is kept of them."""


def run_filter(
    problem: Problem,
    start: CellParameters,
    *,
    gate: float = 1.0,
    progress: StepProgress | None = None,
    belief: Belief | None = None,
    visit: Mapping[int, Callable[[Belief], None]] | None = None,
    slopes: Slopes | None = None,
    points: str | None = None,
    about: Array | None = None,
) -> Fit:
    """Return the result of running the filter over all updates of a problem.

    Parameters
    ----------
    start
        Start values of the estimated groups, and values of those that are not.
    gate
        Factor on the innovation's bound; above 1 where the assumed noise is known to be too small.
    progress
        Called with the share done.
    visit
        By number of an update: what is called with the belief after all updates before it.
    slopes
        Where the slopes of all updates are recorded.
    points
        Which sigma points, or one of `LINEARISATIONS`; those of the problem's settings by default.
    about : (u, size)
        Stored states before the updates, that derivatives are taken about; by default `start` and the mean of what
        changes. Navigation then begins by the parameters of `start`, and not by those of the belief.

    Raises
    ------
    EstimationError
        If the state is no longer finite; the message gives the time.
    """
    updates = problem.schedule.updates
    model = filter_model(problem, start, points, None if slopes is None else slopes.varying)
    readings = problem.sensor.readings.with_effects(effect_sizes(problem), start.sensors.effects)
    begun = belief = first_belief(problem, start) if belief is None else belief
    bounds = np.array([0.0, *(gate * chi_square_bound(GATE, m) for m in range(1, filter_arguments.MEASURED + 1))])
    limit = filter_arguments.Gate(bounds, MAX_REJECTED_IN_A_ROW, np.zeros(1, dtype=np.int64))
    histories, jumps = [], 0
    for begin in range(0, len(updates), _CHUNK):
        chunk = slice(begin, min(begin + _CHUNK, len(updates)))
        reported = pose_regressor(problem, start, updates[chunk], reference_groups(problem, start))
        steps = filter_steps(problem, start, updates[chunk], reported, None if about is None else about[chunk])
        record = filter_record(problem, chunk.stop - chunk.start, slopes=slopes is not None, varying=model.varying.size)
        done = begin
        while done < chunk.stop:
            if limit.rejected[0] >= MAX_REJECTED_IN_A_ROW:
                belief, jumps = _after_a_jump(problem, belief), jumps + 1
            anew = updates[done].new_segment or limit.rejected[0] >= MAX_REJECTED_IN_A_ROW
            belief = _belief_before(problem, start, belief, done, limit.rejected, by_start=about is not None)
            if slopes is not None and anew:
                slopes.restart(done)
            filtered = filter_arguments.Gaussian(belief.mean.copy(), belief.factor.T.copy())
            signal, until = readings.holding(updates[done].first, updates[done].last)
            counted = steps._replace(first=steps.first - signal.begin, last=steps.last - signal.begin)
            done = begin + run(
                model, signal.samples, counted, done - begin,
                _next_event(updates, done, chunk.stop, until, visit or ()) - begin, limit, filtered, record,
            )  # fmt: skip
            belief = Belief(filtered.mean, filtered.upper.T.copy())
            if not np.isfinite(record.nis[done - 1 - begin]):
                seconds = float(problem.sensor.readings.stamps[updates[done - 1].last])
                raise EstimationError(
                    f"the filter's state is no longer finite at {seconds:.2f} s; check units and noise figures, or fix "
                    "groups that are not observable"
                )
            if visit is not None and done in visit:
                visit[done](belief)
            if progress is not None:
                progress(done / len(updates))
        if slopes is not None:
            slopes.add(record, begin)
        histories.append(history_of(problem, updates[chunk], record))
    history = joined(problem, histories, belief.mean)
    parameters = parameters_of(problem, start, belief.mean)
    return Fit(start, belief, parameters, history, jumps=jumps, begun=begun, gate=gate, about=about)


def _after_a_jump(problem: Problem, belief: Belief) -> Belief:
    """Return the belief after many rejected updates: what walks may have jumped, by what it walks in the whole run."""
    for group in problem.noise.offset_walk:
        if group in problem.layout:
            belief = inflate_variance(problem.layout, belief, group, walked_variance(problem, group) ** 0.5)
    return belief


def _belief_before(
    problem: Problem, start: CellParameters, belief: Belief, at: int, rejected: NDArray[np.int64], *, by_start: bool
) -> Belief:
    """Return the belief before an update, with a new start of navigation where there is one.

    by_start: whether that is by the parameters of `start`, and not by those of the belief.
    """
    update = problem.schedule.updates[at]
    if update.new_segment or rejected[0] >= MAX_REJECTED_IN_A_ROW:
        known = start if by_start else parameters_of(problem, start, belief.mean)
        belief = navigation_from_reference(problem, known, belief, at)
        rejected[0] = 0
    return belief


def _next_event(updates: tuple[Update, ...], at: int, stop: int, until: int, visited: Container[int]) -> int:
    """Return the next update before which the belief is changed by other means or asked for, or progress is reported.

    It is update `stop` at the latest, or the first one after sample `until`, up to which the readings are prepared.
    """
    stop = min(at + _MAX_BETWEEN_REPORTS, stop)
    for i in range(at + 1, stop):
        if updates[i].new_segment or updates[i].last > until or i in visited:
            return i
    return stop

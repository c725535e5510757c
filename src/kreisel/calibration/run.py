"""Passes of the filter over a problem: relinearised at each pass, noise corrected where the data say so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.filter_run import (
    GATE,
    FilterRun,
    look_back,
    named,
    stored_state,
)
from kreisel.calibration.frame_errors import with_frame_errors
from kreisel.calibration.noise_factors import (
    NoiseFactors,
    imu_density,
    noise_factors,
    noise_finding,
    with_factors,
    within_bounds,
)
from kreisel.calibration.observability import unshown_groups
from kreisel.calibration.prior import deviation_alone, first_pass, further_pass
from kreisel.calibration.problem import REACH, Problem, assigns_otherwise, hold, rescheduled, with_lasting_errors
from kreisel.calibration.site import gravity_limit
from kreisel.estimation.consistency import correlation_time, gate, lag_one, mean_normalised
from kreisel.estimation.filter import Belief
from kreisel.geometry.rotation import Array
from kreisel.recording import Finding

FIRST_GATE = 100.0
"""How much wider the gate stands in the first pass, when the parameters are still far off."""

MOST_NOISE_PASSES = 8
"""Passes spent at the most on finding noise figures where none are given or the given ones are contradicted."""

COLOURED = 0.3
"""Correlation of neighbouring innovations from which they no longer pass for white."""

MAX_PASSES = 10

NEAR = 3.0
"""Change of a parameter by a pass, in standard deviations, above which the gate stays wide for another one."""

SETTLED = 0.2
"""Change of every parameter by a pass, in standard deviations, below which no further one is needed."""

CURVATURE = 0.2

LONGEST = 40.0
"""Update intervals errors of the reference may last; what lasts longer is no error of the path."""

MOST_LUCK = 5.0
"""Log-likelihood a lasting error must bring before it is believed."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Estimate:
    """Final problem (with the noise finally believed), the run over it, and what to say about both.

    The belief's factor is already multiplied by `correlation_factor`. `contradiction` is the largest factor
    by which given noise figures had to be raised; 1 where none were given, or none had to. `moved` is the largest
    change of a parameter by the last pass, in standard deviations; 0 where the first sufficed.
    """

    problem: Problem
    run: FilterRun
    passes: int
    correlation_factor: float
    contradiction: float
    moved: float
    findings: tuple[Finding, ...]


def estimate(problem: Problem, *, reference_given: bool, imu_given: bool, progress: Progress | None = None) -> Estimate:
    """Return the estimate after all passes.

    Parameters
    ----------
    reference_given, imu_given
        Whether the noise figures are the user's word; they are then changed only if contradicted.
    """
    given = problem
    problem, run, done, changed, moved = _passes(problem, 0, reference_given, imu_given, progress)
    problem, run, done = _lasting_errors(problem, run, done, progress)
    factor = correlation_factor(run)
    unshown = unshown_groups(problem, factor * run.belief.standard_deviation)
    findings: list[Finding] = []
    if unshown:
        problem, run, done, again, moved = _passes(hold(problem, unshown), done, reference_given, imu_given, progress)
        changed |= again
        factor = correlation_factor(run)
        findings.append(
            Finding(
                "motion", f"does not show {', '.join(unshown)}: held at nominal values (--fix does the same at once)"
            )
        )
    if changed:
        findings.append(noise_finding(problem, given=reference_given and imu_given))
    findings += _whiteness(problem, factor)
    contradiction = _contradiction(given, problem, reference=reference_given, imu=imu_given)
    belief = Belief(run.belief.mean, factor * run.belief.factor)
    belief, said = with_frame_errors(problem, run, belief, position_scale_column(problem, run))
    findings += [*said, *gravity_limit(problem, run)]
    return Estimate(problem, replace(run, belief=belief), done, factor, contradiction, moved / factor, tuple(findings))


def _whiteness(problem: Problem, factor: float) -> list[Finding]:
    """Return what to say of innovations that are correlated in time."""
    said = []
    if problem.correlation_time > 0.0:
        said.append(f"the reference's errors on the path last for about {problem.correlation_time:.2g} s")
    if factor > 1.0:
        said.append(f"innovations are correlated in time; standard deviations were multiplied by {factor:.2f} for it")
    return [Finding("whiteness", text) for text in said]


def _contradiction(given: Problem, final: Problem, *, reference: bool, imu: bool) -> float:
    """Return the largest factor between noise figures finally believed and those the user gave."""
    ratios = [1.0]
    if reference:
        ratios += [final.noise.position / given.noise.position, final.noise.orientation / given.noise.orientation]
    if imu:
        ratios += [a / b for a, b in zip(imu_density(final), imu_density(given), strict=True)]
    return max(ratios)


def _passes(
    problem: Problem, done: int, reference_given: bool, imu_given: bool, progress: Progress | None
) -> tuple[Problem, FilterRun, int, bool, float]:
    """Run passes until they are as many as asked for and the noise figures fit.

    Returns also their number, whether the noise figures were changed, and how far the last pass moved the estimates.
    """
    first, moved, far = done, np.inf, True
    run = first_pass(problem, gate=FIRST_GATE, progress=named(progress, f"pass {done + 1}"))
    done, changed = done + 1, False
    while True:
        factors = noise_factors(run, lasting=problem.correlation_time > 0.0).contradicted(
            reference=reference_given, imu=imu_given
        )
        factors = within_bounds(problem, factors)
        if done == first + 1 and problem.reference.quaternions is None:
            factors = NoiseFactors()  # the attitude was a guess: such innovations say nothing of the noise
        settled = factors.agree() or done - first >= MOST_NOISE_PASSES
        if settled and not _another_pass(problem, run, moved, done - first):
            return problem, run, done, changed, moved if done > first + 1 else 0.0
        if done == first + 1:
            far = _bent(problem, run) or assigns_otherwise(problem, run.parameters.clock)
        problem = rescheduled(look_back(problem, run), run.parameters.clock)
        if not factors.agree():
            problem, changed = with_factors(problem, factors), True
        done += 1
        wide = FIRST_GATE if far else 1.0
        before, run = run, further_pass(problem, run, gate=wide, progress=named(progress, f"pass {done}"))
        moved = _distance(problem, before, run)
        if far:
            far = moved > NEAR
            if _let_in(run):
                moved = np.inf  # the usual gate is still to come


def position_scale_column(problem: Problem, run: FilterRun) -> Array:
    """Return what an error of the positions' scale does to the state, one deviation of it, (degrees, 1).

    A chain of links that are all a little too long moves the tool too far throughout. That is no error that averages
    out; it enters the accelerometers' scale factors, as far as these come from motion and not from gravity.
    """
    columns = np.zeros((problem.layout.degrees, 1))
    reference, scale = problem.reference, problem.frame_sd[0] / REACH
    if scale == 0.0 or reference.positions is None:
        return columns
    middle = reference.positions.mean(axis=0)
    stretched = middle + (1.0 + scale) * (reference.positions - middle)
    moved = further_pass(replace(problem, reference=replace(reference, positions=stretched)), run, gate=np.inf)
    base = further_pass(problem, run, gate=np.inf)
    n = len(problem.parameter_names)
    columns[:n, 0] = problem.layout.minus(moved.belief.mean[:, None], base.belief.mean)[:n, 0]
    return columns


def _distance(problem: Problem, before: FilterRun, after: FilterRun) -> float:
    """Return the largest change of a parameter between two results, in standard deviations."""
    n = len(problem.parameter_names)
    change = problem.layout.minus(after.belief.mean[:, None], before.belief.mean)[:n, 0]
    return float(np.max(np.abs(change) / after.belief.standard_deviation[:n], initial=0.0))


def _lasting_errors(
    problem: Problem, run: FilterRun, done: int, progress: Progress | None
) -> tuple[Problem, FilterRun, int]:
    """Return problem and run with the reference's errors as a process in time, if innovations are coloured.

    How long they last is found by likelihood, doubling it from the update interval as long as that pays.
    """
    if problem.settings.passes is not None or correlation_factor(run) == 1.0:
        return problem, run, done
    best, best_run = problem, run
    reference = further_pass(problem, run)
    likelihood = float(reference.history.log_likelihood.sum()) + MOST_LUCK
    time = 0.5 * problem.update_interval
    while time < LONGEST * problem.update_interval:
        trial = with_lasting_errors(problem, time)
        done += 1
        trial_run = further_pass(trial, run, progress=named(progress, f"pass {done}"))
        found = float(trial_run.history.log_likelihood.sum())
        if found > likelihood:
            best, best_run, likelihood = trial, trial_run, found
        elif best is not problem:
            break
        time *= 2.0
    return best, best_run, done


def _another_pass(problem: Problem, run: FilterRun, moved: float, done: int) -> bool:
    """Return whether another pass is asked for, or pays.

    After the first pass it pays where the gate, which stood wide, let in what the usual gate would not: grossly,
    or often; where the clocks are apart by another sample than the poses were assigned to; and where the way from
    the start bends the model. Later, as long as the estimates move.
    """
    if problem.settings.passes is not None:
        return done < problem.settings.passes
    if done >= MAX_PASSES:
        return False
    if done > 1:
        return moved > SETTLED
    if _let_in(run) or problem.settings.polynomial_order > 1 or problem.reference.quaternions is None:
        return True
    return assigns_otherwise(problem, run.parameters.clock) or _bent(problem, run)


def _let_in(run: FilterRun) -> bool:
    """Return whether a wide gate let in what the usual one would not: grossly, or often."""
    bounds = {m: gate(GATE, int(m)) for m in np.unique(run.history.degrees)}
    beyond = run.history.used * run.history.nis / np.array([bounds[m] for m in run.history.degrees])
    return bool((beyond > 4.0).any()) or float(np.mean(beyond > 1.0)) > 0.002


def _bent(problem: Problem, run: FilterRun) -> bool:
    """Return whether the model is curved between the start of a run and its result.

    Angles bend it by the square of the way; an offset and the matrix it is multiplied by, by the product of theirs.
    What they bend is held against the result's deviation, for offsets against that with all else known: a weak motion
    tells them together to much less than each of them.
    """
    layout, n = problem.layout, len(problem.parameter_names)
    way = np.abs(layout.minus(run.belief.mean[:, None], stored_state(problem, run.start))[:, 0])
    deviation = run.belief.standard_deviation
    alone = deviation_alone(run.belief.covariance[:n, :n])
    angles = [layout[g] for g in ("gyro_cross_coupling", "accel_cross_coupling", "alignment") if g in layout]
    moved = max((float(np.max(way[part])) for part in angles), default=0.0)
    if moved**2 > CURVATURE * min((float(np.median(deviation[part])) for part in angles), default=np.inf):
        return True
    for sensor in ("gyro", "accel"):
        matrix, offset = f"{sensor}_cross_coupling", f"{sensor}_offset"
        if matrix in layout and offset in layout:
            product = float(np.max(way[layout[matrix]]) * np.max(way[layout[offset]]))
            if product > CURVATURE * float(np.median(alone[layout[offset]])):
                return True
    return False


def correlation_factor(run: FilterRun) -> float:
    """Return the factor on standard deviations that correlated innovations call for; 1 where they are white.

    Errors of the reference that last over several updates are counted as often as they are seen. Their
    number is effectively divided by the correlation time of the innovations, the larger of those of
    position and orientation. Innovations smaller than believed already leave room for that.
    """
    history = run.history
    path = history.used & ~history.at_rest
    size = 1.0
    if path.any():
        size = min(run.excess * mean_normalised(history.nis[path], history.degrees[path]), 1.0)
    times = []
    for rows in (slice(0, 3), slice(3, 6)):
        series = history.whitened[path, rows]
        if series.shape[0] < 20 or not np.isfinite(series).all():
            continue
        if float(np.mean(lag_one(series, np.ones(series.shape[0], dtype=bool)))) > COLOURED:
            times.append(float(np.mean([correlation_time(series[:, i]) for i in range(3)])))
    return float(np.sqrt(max(1.0, size * max(times, default=1.0))))

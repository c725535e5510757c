"""Passes of the filter over a problem: relinearised at each pass, noise corrected where the data say so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.doubt import with_doubts
from kreisel.calibration.filter_run import (
    GATE,
    FilterRun,
    History,
    first_belief,
    look_back,
    named,
    run_filter,
    stored_state,
)
from kreisel.calibration.noise_factors import (
    NoiseFactors,
    imu_density,
    noise_factors,
    noise_finding,
    with_factors,
    within_bounds,
)
from kreisel.calibration.observability import unshown_groups
from kreisel.calibration.parameters import GROUPS, CellParameters
from kreisel.calibration.problem import Problem, hold, with_lasting_errors
from kreisel.estimation.consistency import correlation_time, gate, lag_one, mean_normalised
from kreisel.estimation.filter import Belief
from kreisel.recording import Finding

FIRST_GATE = 100.0
"""How much wider the gate stands in the first pass, when the parameters are still far off."""

MOST_NOISE_PASSES = 8
"""Passes spent at the most on finding noise figures where none are given or the given ones are contradicted."""

COLOURED = 0.3
"""Correlation of neighbouring innovations from which they no longer pass for white."""

NARROWING = 10.0
MOST_PASSES = 4
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
    by which given noise figures had to be raised; 1 where none were given, or none had to.
    """

    problem: Problem
    run: FilterRun
    passes: int
    correlation_factor: float
    contradiction: float
    findings: tuple[Finding, ...]


def estimate(problem: Problem, *, reference_given: bool, imu_given: bool, progress: Progress | None = None) -> Estimate:
    """Return the estimate after all passes.

    Parameters
    ----------
    reference_given, imu_given
        Whether the noise figures are the user's word; they are then changed only if contradicted.
    """
    given = problem
    problem, run, done, changed = _passes(problem, 0, reference_given, imu_given, progress)
    problem, run, done = _lasting_errors(problem, run, done, progress)
    factor = correlation_factor(run.history)
    unshown = unshown_groups(problem, factor * run.belief.standard_deviation)
    findings: list[Finding] = []
    if unshown:
        problem, run, done, again = _passes(hold(problem, unshown), done, reference_given, imu_given, progress)
        changed |= again
        factor = correlation_factor(run.history)
        findings.append(
            Finding(
                "motion", f"does not show {', '.join(unshown)}: held at nominal values (--fix does the same at once)"
            )
        )
    if changed:
        findings.append(noise_finding(problem, given=reference_given and imu_given))
    findings += _whiteness(problem, factor)
    contradiction = _contradiction(given, problem, reference=reference_given, imu=imu_given)
    run = towards_prior(problem, run)
    belief = Belief(run.belief.mean, factor * run.belief.factor)
    belief, doubts = with_doubts(problem, run, belief)
    findings += doubts
    return Estimate(problem, replace(run, belief=belief), done, factor, contradiction, tuple(findings))


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
) -> tuple[Problem, FilterRun, int, bool]:
    """Run passes until they are as many as asked for and the noise figures fit; return their number too."""
    first = done
    run = run_filter(problem, problem.start, gate=FIRST_GATE, progress=named(progress, f"pass {done + 1}"))
    done, changed = done + 1, False
    while True:
        factors = noise_factors(run.history, lasting=problem.correlation_time > 0.0).contradicted(
            reference=reference_given, imu=imu_given
        )
        factors = within_bounds(problem, factors)
        if done == first + 1 and problem.reference.quaternions is None:
            factors = NoiseFactors()  # the attitude was a guess: such innovations say nothing of the noise
        settled = factors.agree() or done - first >= MOST_NOISE_PASSES
        if settled and not _another_pass(problem, run, done - first):
            return problem, run, done, changed
        problem = look_back(problem, run)
        if not factors.agree():
            problem, changed = with_factors(problem, factors), True
        done += 1
        belief = narrowed_belief(problem, run)
        run = run_filter(problem, run.parameters, belief=belief, progress=named(progress, f"pass {done}"))


def _lasting_errors(
    problem: Problem, run: FilterRun, done: int, progress: Progress | None
) -> tuple[Problem, FilterRun, int]:
    """Return problem and run with the reference's errors as a process in time, if innovations are coloured.

    How long they last is found by likelihood, doubling it from the update interval as long as that pays.
    """
    if problem.settings.passes is not None or correlation_factor(run.history) == 1.0:
        return problem, run, done
    best, best_run = problem, run
    reference = run_filter(problem, run.parameters, belief=narrowed_belief(problem, run))
    likelihood = float(reference.history.log_likelihood.sum()) + MOST_LUCK
    time = 0.5 * problem.update_interval
    while time < LONGEST * problem.update_interval:
        trial = with_lasting_errors(problem, time)
        done += 1
        belief = narrowed_belief(trial, run)
        trial_run = run_filter(trial, run.parameters, belief=belief, progress=named(progress, f"pass {done}"))
        found = float(trial_run.history.log_likelihood.sum())
        if found > likelihood:
            best, best_run, likelihood = trial, trial_run, found
        elif best is not problem:
            break
        time *= 2.0
    return best, best_run, done


def narrowed_belief(problem: Problem, run: FilterRun) -> Belief:
    """Return the belief a further pass begins with: the prior, and the pass before believed `NARROWING` times less.

    Sigma points then stay where the model is nearly linear, also along what the motion hardly tells apart; the
    same data are counted twice by one part in `NARROWING` squared.
    """
    belief = first_belief(problem, run.parameters)
    n = len(problem.parameter_names)
    if n == 0:
        return belief
    prior = belief.factor[:n, :n] @ belief.factor[:n, :n].T
    found = NARROWING**2 * run.belief.covariance[:n, :n]
    # P = (A^-1 + B^-1)^-1 = A (A + B)^-1 B, scaled by the prior's deviations
    scale = np.sqrt(np.diag(prior))
    A, B = (M / np.outer(scale, scale) for M in (prior, found))
    P = A @ np.linalg.solve(A + B, B)
    factor = belief.factor.copy()
    factor[:n, :n] = scale[:, None] * np.linalg.cholesky(0.5 * (P + P.T) + 1e-15 * np.diag(np.diag(P)))
    return Belief(belief.mean, factor)


def _another_pass(problem: Problem, run: FilterRun, done: int) -> bool:
    """Return whether another pass is asked for, or pays.

    It pays where the estimates moved so far from where the pass began that what the sigma points leave of
    the model's curvature, about the square of the way, is not small against the standard deviation; and
    where the first pass, whose gate stands wide, let in what the usual gate would not: grossly, or often.
    """
    if problem.settings.passes is not None:
        return done < problem.settings.passes
    if done >= MOST_PASSES:
        return False
    bounds = {m: gate(GATE, int(m)) for m in np.unique(run.history.degrees)}
    beyond = run.history.used * run.history.nis / np.array([bounds[m] for m in run.history.degrees])
    let_in = bool((beyond > 4.0).any()) or float(np.mean(beyond > 1.0)) > 0.002
    if done == 1 and (let_in or problem.settings.polynomial_order > 1 or problem.reference.quaternions is None):
        return True
    layout = problem.layout
    angles = {"gyro_cross_coupling": 9, "accel_cross_coupling": 9, "alignment": 2}
    parts = [slice(layout[g].start, layout[g].start + n) for g, n in angles.items() if g in layout]
    if not parts:
        return False
    moved = layout.minus(run.belief.mean[:, None], stored_state(problem, run.start))[:, 0]
    way = max(float(np.max(np.abs(moved[part]))) for part in parts)
    deviation = min(float(np.median(run.belief.standard_deviation[part])) for part in parts)
    return way**2 > CURVATURE * deviation


def correlation_factor(history: History) -> float:
    """Return the factor on standard deviations that correlated innovations call for; 1 where they are white.

    Errors of the reference that last over several updates are counted as often as they are seen. Their
    number is effectively divided by the correlation time of the innovations, the larger of those of
    position and orientation. Innovations smaller than believed already leave room for that.
    """
    path = history.used & ~history.at_rest
    size = min(mean_normalised(history.nis[path], history.degrees[path]), 1.0) if path.any() else 1.0
    times = []
    for rows in (slice(0, 3), slice(3, 6)):
        series = history.whitened[path, rows]
        if series.shape[0] < 20 or not np.isfinite(series).all():
            continue
        if float(np.mean(lag_one(series, np.ones(series.shape[0], dtype=bool)))) > COLOURED:
            times.append(float(np.mean([correlation_time(series[:, i]) for i in range(3)])))
    return float(np.sqrt(max(1.0, size * max(times, default=1.0))))


def towards_prior(problem: Problem, run: FilterRun) -> FilterRun:
    """Return the run with the prior put back where it belongs.

    A pass that starts from estimates carries its prior centred there. To first order the mean is mended by
    the posterior covariance times the prior's information times the distance of the two centres.
    """
    layout = problem.layout
    change = np.zeros(layout.degrees)
    start = stored_state(problem, run.start)
    for group in problem.groups:
        d, s = layout[group], layout.stored(group)
        if group == "alignment":
            continue  # its prior is weak, and its centre a rotation
        change[d] = np.linalg.solve(problem.prior_covariance[group], problem.prior.stored(group) - start[s])
    moved = run.belief.covariance @ change
    mean = layout.plus(run.belief.mean, moved[:, None])[:, 0].copy()
    values = {g: run.parameters.stored(g) for g in GROUPS}
    values.update({g: mean[layout.stored(g)] for g in problem.groups})
    return replace(run, belief=Belief(mean, run.belief.factor), parameters=CellParameters.from_stored(values))

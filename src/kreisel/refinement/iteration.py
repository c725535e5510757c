"""Passes of the filter over a problem: relinearised at each pass, noise corrected where the data contradict it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from kreisel.errors import EstimationError
from kreisel.estimation.uncertainty import Contribution, scaling
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import WIDE_GATE, Estimator, Fit, Linearised
from kreisel.fitting.result_change import with_unit_of_data
from kreisel.model.assumed_noise import PoseError
from kreisel.model.considered_terms import Considered, describe
from kreisel.model.parameters import GROUPS, OF_EARTH
from kreisel.model.problem import Problem, with_correlation_time
from kreisel.progress import Progress, StepProgress, of_step
from kreisel.recording.recording import DataWarning
from kreisel.refinement.arm_size import most_likely_size, with_arm_size, with_larger_frames
from kreisel.refinement.attenuation import pull_of_noise, without_attenuation
from kreisel.refinement.correlated_innovations import bounded_likelihood, correlation_factor
from kreisel.refinement.discrepancy import Discrepancy, find_discrepancy, prepared_terms
from kreisel.refinement.discrepancy_terms import FIELD, PRODUCTS, TIME, DiscrepancyTerms
from kreisel.refinement.effect_selection import Survey, considered, selected, survey, without_needless
from kreisel.refinement.estimate import Estimate
from kreisel.refinement.named_terms import OFFSET_OF
from kreisel.refinement.noise_adaptation import StatedFigures, noise_ratios, noise_warning, with_noise_of
from kreisel.refinement.nominal_values import with_nominal_values
from kreisel.refinement.parameter_walk import found_walks, may_walk
from kreisel.refinement.prior_conflict import OFFSETS, contradicted_offsets, prior_penalty, with_wider_priors
from kreisel.refinement.settling import Settling
from kreisel.refinement.turning_reference import (
    MIMICS,
    earth_rate_warning,
    lacks_earth_rate,
    may_lack_earth_rate,
    turn_of,
    turn_warning,
    with_free_earth_rate,
    with_turn,
)
from kreisel.refinement.wrong_stamps import wrong_stamps_warning
from kreisel.tasks import Executor, sequential

MAX_ROUNDS = 4
"""Largest number of times that further effects, or parameters that walk, are looked for."""

_LASTING, _HARDLY_NOISE = 3.0, 3.0
"""Factors for correlated innovations, and between noise found and given, above which the noise found may stand for
parameters that walk."""

MAX_CORRELATION_TIME = 40.0
"""Largest time constant of coloured noise, in update intervals; an error that lasts longer is not one of the path."""

_CLEARLY = 50.0
"""Gain of log-likelihood with which terms take the place of a walk. Chosen: they have some forty amplitudes, a walk has
one size."""

_MUCH = 500.0
"""Gain of products of rates from which walks are tried without. Chosen: it was 3,200 and more where a device takes out
centripetal forces, and 45 to 270 where offsets follow a motor's current."""

MIN_LIKELIHOOD_GAIN = 5.0
"""Minimum gain of log-likelihood with which coloured noise is assumed."""


@dataclass(frozen=True)
class _Work:
    """What every step needs: whose noise figures were given, the estimator, progress, and how tasks run together."""

    given: StatedFigures
    estimator: Estimator
    progress: Progress | None
    executor: Executor

    linearised: list[tuple[Problem, Fit, Linearised]] = field(default_factory=list)
    """The last linearisation, with the problem and the fit that it is about."""

    terms: DiscrepancyTerms | None = None
    """Terms that the problem which was begun with may have."""

    def step(self, name: str) -> StepProgress | None:
        return of_step(self.progress, name)

    def linear(self, problem: Problem, near: Fit) -> Linearised:
        """Return a linearisation of a problem about a fit."""
        for known, about, found in self.linearised:
            if known is problem and about is near:
                return found
        self.linearised.clear()
        found = self.estimator.linearise(problem, near, self.step("linearise"))
        self.linearised.append((problem, near, found))
        return found

    def surveyed(self, problem: Problem, near: Fit, step: StepProgress | None) -> Survey | None:
        """Return what the data say of candidates beyond a problem's fit."""
        return survey(problem, near, partial(self.linear, problem, near), self.estimator, step, self.executor)


@dataclass(frozen=True)
class _Passes:
    """Result of several passes.

    Attributes
    ----------
    problem, run
        After the last one.
    count
        Number of passes.
    adapted
        Whether noise figures were changed.
    moved
        How far the last pass moved the estimates, in standard deviations; 0 after a single one.
    survey, surveyed
        The last look at further effects, and the problem it was made for.
    walk_gain
        What the walk of each group gained in log-likelihood.
    """

    problem: Problem
    run: Fit
    count: int
    adapted: bool = False
    moved: float = 0.0
    survey: Survey | None = None
    surveyed: Problem | None = None
    walk_gain: Mapping[str, float] = field(default_factory=dict)


def estimate(
    problem: Problem,
    given: StatedFigures,
    estimator: Estimator,
    progress: Progress | None = None,
    executor: Executor = sequential,
) -> Estimate:
    """Return the estimate after all passes.

    Parameters
    ----------
    given
        Whose noise figures the user gave.
    estimator
        Makes the passes.
    executor
        Does passes that do not depend on each other.

    Raises
    ------
    EstimationError
        If the estimate does not stay finite.
    """
    try:
        return _estimate(problem, _Work(given, estimator, progress, executor))
    except np.linalg.LinAlgError as error:
        raise EstimationError(
            f"the estimate's covariance does not stay positive ({error}): the noise figures, or the grade, in "
            "recording.toml are far from the data, or the readings have gross errors"
        ) from error


def _estimate(problem: Problem, work: _Work) -> Estimate:
    begun, terms = work.executor([partial(_until_settled, problem, 0, work), partial(prepared_terms, problem)])
    work = replace(work, terms=terms)
    passes = _with_arm_size(_without_earth_rate(begun, work), work)
    passes = _without_contradiction(problem, passes, work)
    passes = _without_needless(problem, _with_effects(problem, passes, work), work)
    passes = _without_contradiction(problem, passes, work)
    shown = _with_hidden_effects(problem, passes, *_with_discrepancy(problem, passes, work), work)
    shown = _without_field(problem, passes, *shown, work)
    passes, discrepancy = _without_walk(problem, passes, *shown, work)
    contradicted = _contradicted(problem, passes, problem)
    adapted = passes.adapted
    passes = _with_coloured_noise(passes, work)
    factor = correlation_factor(passes.run)
    warnings: list[DataWarning] = []
    passes = replace(passes, run=with_unit_of_data(passes.problem, passes.run))
    passes, attenuation = _without_attenuation(passes, work)
    warnings += discrepancy.warnings
    if adapted:
        warnings.append(noise_warning(passes.problem, given=work.given.reference and work.given.imu))
    warnings += [*wrong_stamps_warning(passes.problem), *_whiteness(passes.problem, factor)]
    warnings += turn_warning(problem, passes.problem, passes.run)
    warnings += earth_rate_warning(problem, passes.problem)
    last = _last_survey(passes, work)
    found = passes.problem
    run, errors = with_nominal_values(found, passes.run, factor)
    included = tuple(g for g in found.groups if g not in (*problem.groups, *OF_EARTH))
    before = problem.noise.offset_walk
    walks = {g: gain for g, gain in passes.walk_gain.items() if found.noise.offset_walk[g] > before.get(g, 0.0)}
    estimate = Estimate(
        _with_larger_frames(problem, passes, work),
        run,
        work.estimator,
        passes.count,
        factor,
        _contradiction(problem, found, work.given),
        passes.moved / factor,
        (),
        walks=walks,
        contradicted=contradicted,
        stated=problem,
        discrepancy=discrepancy.found,
        linear=next((linear for problem, _, linear in work.linearised if problem is found), None),
    )
    of_terms = discrepancy.contributions(found.layout.degrees)
    estimate = estimate.adding([
        *(replace(one, columns=factor * errors @ one.columns) for one in (*attenuation, *of_terms)),
        scaling("correlated innovations", Source.PATH, run.belief.factor, factor),
        *(() if last is None else [Contribution("undecided error terms", Source.EFFECTS, last.undecided())]),
    ])  # fmt: skip
    effects = considered(last, found, replace(run, belief=estimate.belief), included)
    return replace(estimate, considered=effects, warnings=(*warnings, *_found(effects, walks), *_wider(contradicted)))


def _without_attenuation(passes: _Passes, work: _Work) -> tuple[_Passes, list[Contribution]]:
    """Return the passes with a result in which noise of the readings does not count as information."""
    if passes.problem.settings.passes is not None:
        return passes, []
    pull = pull_of_noise(passes.problem, passes.run, work.estimator, work.step("noise"), work.executor)
    if pull is None:
        return passes, []
    run, uncertainty = without_attenuation(passes.problem, passes.run, pull)
    return replace(passes, run=run), [uncertainty]


def _contradicted(first: Problem, passes: _Passes, stating: Problem) -> dict[str, float]:
    """Return the offsets whose prior in a problem the data contradict, but those that walk: they are not one value."""
    if passes.problem.settings.passes is not None:
        return {}
    found = contradicted_offsets(replace(passes.problem, prior=stating.prior), passes.run)
    walks, before = passes.problem.noise.offset_walk, first.noise.offset_walk
    return {group: score for group, score in found.items() if not walks.get(group, 0.0) > before.get(group, 0.0)}


def _without_contradiction(first: Problem, passes: _Passes, work: _Work) -> _Passes:
    """Return the passes with wider priors of offsets, where the data contradict those that are stated."""
    for _ in range(MAX_ROUNDS):  # a narrow prior hides how far away the data lie
        scores = _contradicted(first, passes, passes.problem)
        if not scores:
            break
        wider = with_wider_priors(passes.problem, scores)
        again = _until_settled(wider, passes.count, work, passes.run)
        passes = replace(again, survey=passes.survey, walk_gain=passes.walk_gain)
    return passes


def _wider(contradicted: Mapping[str, float]) -> list[DataWarning]:
    """Return the warnings about stated priors that had to be widened."""
    return [
        DataWarning(
            "offsets",
            f"{OFFSETS[group]} offsets lie {score:.1f} stated deviations away: "
            f"what is stated is not used (imu.{group}_sd or imu.grade in recording.toml)",
        )
        for group, score in contradicted.items()
    ]


def _last_survey(passes: _Passes, work: _Work) -> Survey | None:
    """Return the survey of the final problem: the last one, if the problem has not changed since."""
    found = passes.survey
    if passes.problem.settings.passes is not None or found is None:
        return None
    if passes.surveyed is passes.problem:
        return found
    return work.surveyed(passes.problem, passes.run, work.step("effects"))


def _found(effects: tuple[Considered, ...], walks: Mapping[str, float]) -> list[DataWarning]:
    """Return the warnings about effects and walks that are part of the model because the data show them."""
    messages = [f"{describe(effect)} (gain {effect.gain:.0f})" for effect in effects if effect.included]
    messages += [f"{GROUPS[group].split(',')[0]} changes during the recording" for group in walks]
    if not messages:
        return []
    return [DataWarning("effects", f"found in the data and estimated: {'; '.join(messages)}")]


def _whiteness(problem: Problem, factor: float) -> list[DataWarning]:
    """Return the warnings about innovations that are correlated in time."""
    messages, time = [], problem.noise.correlation_time
    if time > 0.0:
        messages.append(f"the reference has coloured noise on the path, with a time constant of about {time:.2g} s")
    if factor > 1.0:
        messages.append(
            f"innovations are correlated in time; standard deviations were therefore multiplied by {factor:.2f}"
        )
    return [DataWarning("whiteness", message) for message in messages]


def _contradiction(before: Problem, after: Problem, given: StatedFigures) -> float:
    """Return the largest factor between noise finally assumed, on the path and of the IMU, and what the user gave."""
    ratios = [1.0]
    if given.reference:
        ratios += noise_ratios(before, after)[:2]
    if given.imu:
        ratios += noise_ratios(before, after)[2:]
    return max(ratios)


def _until_settled(problem: Problem, before: int, work: _Work, begun: Fit | None = None) -> _Passes:
    """Run passes until their number is the requested one and the noise figures fit; `before` were run already.

    They start at the problem's start values, or near the result of a run over the same parameters.
    """
    estimator, step = work.estimator, work.step(f"pass {before + 1}")
    if begun is None:
        run = estimator.fit(problem, gate=WIDE_GATE, progress=step)
    else:
        run = estimator.refit(problem, begun, gate=WIDE_GATE, progress=step)
    passes = Settling(problem, run, work.given)
    while (following := passes.following()) is not None:
        step = work.step(f"pass {before + passes.count + 1}")
        passes.take(following, estimator.refit(following, passes.near, gate=passes.gate, progress=step))
    moved = passes.moved if passes.count > 1 else 0.0
    return _Passes(passes.problem, passes.run, before + passes.count, passes.adapted, moved)


def _without_earth_rate(passes: _Passes, work: _Work) -> _Passes:
    """Return the passes with an unknown rotation of the Earth, where gyros show none of the stated one."""
    problem, run = passes.problem, passes.run
    if problem.settings.passes is not None or not may_lack_earth_rate(problem, run):
        return passes
    free = _until_settled(with_free_earth_rate(problem, run), passes.count, work)
    return free if lacks_earth_rate(free.problem, free.run) else passes


def _with_effects(first: Problem, passes: _Passes, work: _Work) -> _Passes:
    """Return the passes with the effects that the recording shows, settled again.

    With further effects in the state the noise is found again from that of `first`, the problem at the beginning.
    """
    if passes.problem.settings.passes is not None:
        return passes
    for _ in range(MAX_ROUNDS):
        problem, run, count = passes.problem, passes.run, passes.count + 1
        correlation, step = correlation_factor(run), work.step(f"pass {count}")
        quiet = with_noise_of(first, problem)  # noise that was found explains what effects would
        least = MIN_LIKELIHOOD_GAIN * correlation**2
        found = work.surveyed(quiet, run, step)
        walk = None
        clean = quiet is problem and correlation == 1.0  # else the size of a score by chance is not known
        if not clean or may_walk(quiet, work.linear(quiet, run)):
            walk = found_walks(problem, run, work.estimator, least, step, work.executor)
        chosen = () if found is None else selected(found)
        if walk is None and correlation > _LASTING and _contradiction(first, problem, work.given) > _HARDLY_NOISE:
            again = work.estimator.repeat(quiet, run, step)
            walk = found_walks(quiet, again, work.estimator, least, step, work.executor)
        larger = [] if walk is None else [(walk[0], run)]
        larger += [] if found is None else _with_chosen(found, chosen, work.estimator)
        as_it_is = replace(passes, count=count, survey=found, surveyed=problem)
        if not larger:
            return as_it_is
        tried = work.executor(
            [partial(_until_settled, with_noise_of(first, one), count, work, begun) for one, begun in larger]
        )
        if problem.noise.correlation_time == 0.0:
            coloured = _with_coloured_noise(passes, work)
            tried += [coloured] if coloured.problem is not problem else []
        best = max(tried, key=_probability)
        if _probability(best) < _probability(passes):
            return as_it_is
        gain = {**passes.walk_gain, **walk[1]} if walk is not None and best is tried[0] else passes.walk_gain
        passes = replace(best, survey=found, walk_gain=gain)
    return passes


def _with_chosen(found: Survey, chosen: tuple[str, ...], estimator: Estimator) -> list[tuple[Problem, Fit]]:
    """Return the problem with chosen effects and the fit that its passes begin near; empty if none is chosen.

    A turn of the reference takes the place of gyros that would respond to acceleration as it looks.
    """
    rate = 0.0
    if MIMICS in chosen:
        rate = turn_of(found.before, found.fit, *found.alone((MIMICS,)), found.usual[MIMICS])
    kept = tuple(group for group in chosen if group != MIMICS or rate == 0.0)
    problem, fit = found.conditioned(kept) if kept else (found.before, found.fit)
    if rate:
        turning = with_turn(problem, fit, rate)
        return [(turning, estimator.fit(turning, gate=WIDE_GATE))]
    return [(problem, fit)] if kept else []


def _without_needless(first: Problem, passes: _Passes, work: _Work) -> _Passes:
    """Return the passes without effects for which there is no evidence beside those that were found after them."""
    for _ in range(MAX_ROUNDS):
        included = tuple(g for g in passes.problem.groups if g not in (*first.groups, *OF_EARTH))
        less = without_needless(passes.problem, passes.run, included)
        if less is None:
            break
        again = _until_settled(less[0], passes.count, work, less[1])
        if _probability(again) < _probability(passes) - MIN_LIKELIHOOD_GAIN:
            break
        passes = replace(again, survey=passes.survey, walk_gain=passes.walk_gain)
    return passes


def _with_discrepancy(
    first: Problem, passes: _Passes, work: _Work, left_out: Sequence[str] = (), near: Fit | None = None
) -> tuple[_Passes, Discrepancy]:
    """Return the passes with data corrected by terms for errors that are on no list, where the data ask for them.

    left_out: as in `find_discrepancy`. near: a fit that is nearer than that of the passes, if one is known.
    """
    if passes.problem.settings.passes is not None:
        return passes, Discrepancy()
    last = passes

    def settle(problem: Problem, near: Fit) -> tuple[Problem, Fit]:
        nonlocal last
        again = _until_settled(with_noise_of(first, problem), last.count, work, near)
        again = replace(again, survey=passes.survey, walk_gain=passes.walk_gain)
        last = _without_contradiction(first, again, work)
        return last.problem, last.run

    def least_noise(problem: Problem) -> float:
        return float(1.0 / max(1.0, *noise_ratios(first, problem)) ** 2)

    found = find_discrepancy(passes.problem, near or passes.run, work.linear, settle, least_noise, work.terms, left_out)
    if not found.found:
        return passes, found
    if _probability(last) < _probability(passes):
        return passes, Discrepancy()
    return last, found


def _with_hidden_effects(
    first: Problem, before: _Passes, after: _Passes, found: Discrepancy, work: _Work
) -> tuple[_Passes, Discrepancy]:
    """Return passes and terms with effects that only show once errors on no list are taken out of the data.

    Before, they were hidden by these, and their share was taken by the terms: all is found again with them, and kept if
    that is likelier.

    before, after: the passes without and with the terms that were found.
    """
    if not found.found:
        return after, found

    shown = work.surveyed(after.problem, after.run, work.step("effects"))
    after = replace(after, survey=shown, surveyed=after.problem)
    hidden = () if shown is None else selected(shown)
    at_first = work.surveyed(before.problem, before.run, work.step("effects")) if hidden else None
    if at_first is None or not set(hidden) <= set(at_first.groups):
        return after, found
    problem, begun = at_first.conditioned(hidden)
    once = _until_settled(with_noise_of(first, problem), after.count, work, begun)
    again, terms = _with_discrepancy(first, replace(once, survey=shown, walk_gain=before.walk_gain), work)
    return (again, terms) if _probability(again) > _probability(after) else (after, found)


def _without_field(
    first: Problem, before: _Passes, after: _Passes, found: Discrepancy, work: _Work
) -> tuple[_Passes, Discrepancy]:
    """Return passes and terms without a field that sensors seem to follow, if effects that have a name are likelier.

    A field takes the share of named effects, such as the gyros' response to acceleration, where errors on no list
    hide them at first; few devices follow one.

    before, after: the passes without and with the terms that were found.
    """
    if not any(one.family.of == FIELD for one in found.found):
        return after, found
    other = _with_hidden_effects(first, before, *_with_discrepancy(first, before, work, (FIELD,)), work)
    return other if _probability(other[0]) > _probability(after) else (after, found)


def _without_walk(
    first: Problem, before: _Passes, after: _Passes, found: Discrepancy, work: _Work
) -> tuple[_Passes, Discrepancy]:
    """Return passes and terms without parameters that walk, if terms explain clearly more than their walk does.

    What follows a field that is fixed in the cell, or products of rates, looks like a walk before it is known.
    Functions of time would only be another walk.

    before, after: the passes without and with the terms that were found.
    """
    alone = [one for one in found.found if one.family.of == FIELD or (one.family.of == PRODUCTS and one.gain > _MUCH)]
    followed = {OFFSET_OF.get(one.family.owner) for one in alone}
    if not followed & set(before.walk_gain):
        return after, found
    usual = {group: walk for group, walk in first.noise.offset_walk.items() if group in followed}
    steady, corrected = (
        with_noise_of(first, replace(one, noise=replace(one.noise, offset_walk={**one.noise.offset_walk, **usual})))
        for one in (before.problem, after.problem)
    )
    near = _until_settled(corrected, after.count, work, after.run)
    again, terms = _with_discrepancy(first, replace(before, problem=steady, count=near.count), work, (TIME,), near.run)
    clearly = bool(terms.found) and _probability(again) > _probability(after) + _CLEARLY
    return (again, terms) if clearly else (after, found)


def _with_arm_size(passes: _Passes, work: _Work) -> _Passes:
    """Return the passes with errors of an arm as large as the data show, where nobody stated them.

    Noise is that of the usual size while sizes are compared: it must not stand for the arm.
    """
    noise = passes.problem.noise
    if not _of_assumed_arm(passes.problem):
        return passes
    gyro_noise = float(np.sqrt(np.max(passes.problem.sensor.readings.noise[0])))
    found = with_arm_size(noise, _size_of_arm(passes, noise.pose_error, work), gyro_noise)
    if found is noise:
        return passes
    problem = replace(passes.problem, noise=found)
    again = _until_settled(problem, passes.count, work, passes.run)
    return replace(again, adapted=passes.adapted or again.adapted)


def _with_larger_frames(first: Problem, passes: _Passes, work: _Work) -> Problem:
    """Return the passes' problem with frames of an arm as large as its errors are now that all effects are known."""
    problem, usual = passes.problem, first.noise
    if not _of_assumed_arm(problem):
        return problem
    size = _size_of_arm(passes, usual.pose_error, work)
    return replace(problem, noise=with_larger_frames(problem.noise, usual, size))


def _of_assumed_arm(problem: Problem) -> bool:
    """Return whether the reference is an arm whose errors are assumed, for nobody stated them."""
    return problem.noise.pose_error.assumed and problem.settings.passes is None


def _size_of_arm(passes: _Passes, usual: PoseError, work: _Work) -> float:
    """Return the most likely size of an arm's errors, over the usual one, near the passes' result."""

    def log_probability(size: float) -> float:
        noise = replace(passes.problem.noise, pose_error=usual.larger(size / usual.repeated))
        trial = replace(passes.problem, noise=noise)
        return _probability(replace(passes, problem=trial, run=work.estimator.refit(trial, passes.run)))

    return most_likely_size(log_probability)


def _probability(passes: _Passes) -> float:
    """Return the logarithm of the probability of data and estimate, up to a constant."""
    return bounded_likelihood(passes.run) - prior_penalty(passes.problem, passes.run)


def _with_coloured_noise(passes: _Passes, work: _Work) -> _Passes:
    """Return the passes with coloured noise of the reference, if innovations are correlated.

    Its time constant is found by likelihood: it is doubled from half the update interval while the likelihood grows.
    """
    problem, run, count = passes.problem, passes.run, passes.count
    if problem.settings.passes is not None or correlation_factor(run) == 1.0 or problem.noise.correlation_time > 0.0:
        return passes
    best = passes
    likelihood = float(work.estimator.refit(problem, run).history.log_likelihood.sum()) + MIN_LIKELIHOOD_GAIN
    interval = problem.schedule.interval
    time = 0.5 * interval
    while time < MAX_CORRELATION_TIME * interval:
        trial = with_correlation_time(problem, time)
        count += 1
        trial_run = work.estimator.refit(trial, run, progress=work.step(f"pass {count}"))
        found = float(trial_run.history.log_likelihood.sum())
        if found > likelihood:
            best, likelihood = replace(passes, problem=trial, run=trial_run), found
        elif best is not passes:
            break
        time *= 2.0
    return replace(best, count=count)

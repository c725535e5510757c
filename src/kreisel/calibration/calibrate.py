"""From a recording to a calibration: all steps in their order."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

from kreisel.calibration.array_checks import check_recording
from kreisel.calibration.assembly import Assessment, assemble
from kreisel.calibration.cross_validation import cross_validate
from kreisel.calibration.evidence import (
    CrossValidation,
    Evidence,
    LackOfFit,
    LatitudeCheck,
    Split,
    SplitHalves,
    StatedValue,
)
from kreisel.calibration.filter_budget import budget_of, filter_parts
from kreisel.calibration.inflation import (
    with_doubtful_latitude,
    with_open_periods,
    with_unestimated_errors,
    with_walked_deviations,
)
from kreisel.calibration.interval_check import interval_disagreement
from kreisel.calibration.lack_of_fit import (
    lack_of_fit,
    lack_of_fit_disagreement,
    larger_deviations,
    within_subsets,
)
from kreisel.calibration.latitude_check import check_latitude
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.calibration.split_halves import halves_disagreement, middle_of, split_halves
from kreisel.calibration.splits import compare_splits, splits_disagreement
from kreisel.calibration.stated_values import stated_values, without_stated
from kreisel.calibration.time_base_choice import better_base, is_open, with_choice, with_either, with_time_base
from kreisel.calibration.verdict import MAX_MOVED, consistency, judge
from kreisel.errors import EstimationError, KreiselError, SettingsError
from kreisel.estimation.sigma_points import DERIVATIVES, ITERATED
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.fit import Estimator
from kreisel.geometry.rotation import Array
from kreisel.inverse.inverse_filter import InverseFilter
from kreisel.kalman.batch import Batch, path_near
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import Problem, without_forces
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.plausibility import check_start_values
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.progress import Progress, of_parts, of_step, shown
from kreisel.recording.recording import Recording
from kreisel.refinement.estimate import Estimate, without_passing
from kreisel.refinement.iteration import estimate
from kreisel.refinement.noise_adaptation import StatedFigures
from kreisel.refinement.observability import observability
from kreisel.tasks import Executor, sequential

ESTIMATORS: dict[str, Estimator] = {
    one.name: one
    for one in (
        KalmanFilter(),
        KalmanFilter("ukf", "unscented"),
        KalmanFilter("cdkf", "central-difference"),
        KalmanFilter("ckf", "cubature"),
        KalmanFilter("ekf", DERIVATIVES),
        KalmanFilter("iekf", ITERATED),
        InverseFilter(KalmanFilter("inverse", DERIVATIVES)),
        Batch(),
    )
}
"""What the names in `model.calibration_settings.ESTIMATORS` stand for."""


def calibrate(
    recording: Recording, settings: CalibrationSettings | None = None, *, progress: Progress | bool = False
) -> Calibration:
    """Return the calibration of a recording.

    Parameters
    ----------
    progress
        True: the step and its share are shown while it runs, in a notebook's output or on standard error. Or a
        function that is called with the name of the step and the share of it that is done, 0 to 1.

    Raises
    ------
    KreiselError
        If the recording cannot be used; the message says what, where and what to do.
    """
    check_recording(recording)
    if not isinstance(settings, CalibrationSettings | None):
        raise SettingsError(f"settings: got {type(settings).__name__}, expected CalibrationSettings(…)")
    with shown(progress) as show:
        outcome = run_calibration(recording, settings or CalibrationSettings(), show, budget=True)
    return replace(outcome.calibration, updates=outcome.estimate.run.history)


def run_calibration(
    recording: Recording,
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    executor: Executor = sequential,
    validate: bool = False,
    budget: bool = False,
) -> Outcome:
    """Return the calibration of a recording with all intermediate results.

    Parameters
    ----------
    progress
        Called with the name of the step and the share of it that is done.
    executor
        Runs checks that do not depend on each other.
    validate
        Whether to cross-validate, too.
    budget
        Whether to split the variances by their sources.
    """
    if progress is not None:
        progress("synchronise", 0.0)
    settings = settings.with_stated(recording.settings.fixed, recording.settings.prior)
    recording = _in_use(recording, settings)
    began = time.perf_counter()
    first = _with_time_base(_begun(recording, settings, progress, executor), settings, progress, executor)
    preparation, given = first.preparation, first.given
    found = with_unestimated_errors(first.found)
    seconds = time.perf_counter() - began
    found, checks = _checked(found, progress, executor, validate=validate, budget=budget)
    found = replace(found, linear=None)  # it keeps the slopes of all updates
    seen = observability(found.problem, found.deviation)
    found = with_doubtful_latitude(with_walked_deviations(found, path_near), checks.latitude)
    seen = replace(seen, posterior=found.deviation[: len(seen.names)])
    found = with_open_periods(found, preparation.correlation.periods)
    facts = consistency(found, preparation.correlation)
    stated = _compared(found, preparation, given, progress)
    lack, halves = checks.lack, checks.halves
    parts = 0 if lack is None else len(lack.influence)
    verdict = judge(found, Evidence(seen, facts, halves, checks.latitude, stated, parts))
    warnings = (*recording.warnings, *preparation.warnings, *found.warnings)
    whole = None if checks.of_filter is None else budget_of(found, checks.of_filter)
    calibration = assemble(preparation.recording, found, Assessment(seen, facts, verdict, seconds, whole), warnings)
    return Outcome(
        recording, preparation, found.problem, found, seen, facts, halves, verdict, warnings, calibration, lack,
        checks.cross, checks.splits,
    )  # fmt: skip


@dataclass(frozen=True)
class _Checks:
    """What was checked of an estimate; `of_filter` are the sources' shares of the estimator's own variance."""

    lack: LackOfFit | None
    halves: SplitHalves | None
    splits: tuple[Split, ...]
    latitude: LatitudeCheck | None
    cross: CrossValidation | None
    of_filter: Mapping[Source, Array] | None


def _checked(
    found: Estimate, progress: Progress | None, executor: Executor, *, validate: bool, budget: bool
) -> tuple[Estimate, _Checks]:
    """Return the estimate of what lasts with what its checks add to its uncertainty, and the checks.

    All checks are of the estimate as it is; what they add is added afterwards.
    """
    of_latitude, of_halves, of_cross, of_fit, of_budget, of_interval = of_parts(progress, "checks", 6)
    latitude, halves, cross, lack, of_filter, by_interval = executor(
        [
            partial(check_latitude, found, of_latitude),
            partial(split_halves, found, of_halves, executor),
            partial(cross_validate, found, of_cross) if validate else _nothing,
            partial(lack_of_fit, found, of_step(of_fit, "fit")),
            partial(filter_parts, found, of_budget) if budget else _nothing,
            partial(interval_disagreement, found, of_interval),
        ]
    )
    compared = compare_splits(found, lack)
    checks = _Checks(
        lack, _by_scatter(halves, found, lack), tuple(split for split, _ in compared), latitude,
        cross, of_filter,
    )  # fmt: skip
    by_halves = halves_disagreement(without_passing(found), halves)
    by_parts = lack_of_fit_disagreement(found, larger_deviations(found, lack))
    for more in (by_interval, by_parts, splits_disagreement(compared)):
        found = found.adding(more.contributions, more.warnings)
    return without_passing(found).adding(by_halves.contributions, by_halves.warnings), checks


def _nothing() -> None:
    """Return nothing: the result of a check that is not asked for."""


def _in_use(recording: Recording, settings: CalibrationSettings) -> Recording:
    """Return the recording with the part of its reference that is to be used.

    Raises
    ------
    SettingsError
        If the reference does not have it.
    """
    reference = recording.reference
    if settings.use is None or reference is None:
        return recording
    if reference.quaternions is None:
        raise SettingsError(f"--use {settings.use}: {reference.source} holds positions only")
    return replace(recording, reference=replace(reference, positions=None))


def _by_scatter(halves: SplitHalves | None, found: Estimate, lack: LackOfFit | None) -> SplitHalves | None:
    """Return halves that may differ by as much as the parts of one half do."""
    if halves is None:
        return None
    within = None if lack is None else within_subsets(lack, lack.blocks.ends <= middle_of(found.problem))
    factor = larger_deviations(found, lack, within)
    return replace(halves, deviation=factor[found.problem.lasting] * halves.deviation)


@dataclass(frozen=True)
class _Begun:
    """A recording's estimate before it is judged: what it was prepared to, the problem as stated, and the result."""

    preparation: Preparation
    problem: Problem
    given: StatedFigures
    found: Estimate


def _begun(
    recording: Recording, settings: CalibrationSettings, progress: Progress | None, executor: Executor
) -> _Begun:
    """Return the estimate of a recording."""
    preparation = prepare_recording(recording, settings, executor)
    check_start_values(preparation)
    problem = build_problem(preparation, settings)
    table = recording.settings.reference
    stated = table.position_sd is not None or table.orientation_sd is not None
    given = StatedFigures(stated, preparation.imu_noise.given)
    estimator = estimator_for(problem)
    if problem.reference.positions is not None or settings.only == "accelerometer":
        return _Begun(preparation, problem, given, estimate(problem, given, estimator, progress, executor))
    try:
        found = estimate(problem, given, estimator, progress, executor)
    except EstimationError:
        found = None
    if found is None or found.moved > MAX_MOVED:
        # velocities that nothing measures; the gyros need none
        problem = without_forces(problem)
        found = estimate(problem, given, estimator, progress, executor)
    return _Begun(preparation, problem, given, found)


def estimator_for(problem: Problem) -> Estimator:
    """Return the estimator that a problem's settings name, or that its reference asks for.

    Without orientations attitudes are far off at first, and sigma points see further than derivatives do.
    """
    settings = problem.settings
    usual = "ekf" if settings.sigma_points is None and problem.reference.quaternions is not None else "spkf"
    return ESTIMATORS[settings.estimator or usual]


def _with_time_base(
    first: _Begun, settings: CalibrationSettings, progress: Progress | None, executor: Executor
) -> _Begun:
    """Return the estimate by the seconds of the clock that the data show to be right, where they do."""
    preparation = first.preparation
    if settings.passes is not None or not is_open(preparation):
        return first
    skew = preparation.rate_fit.clock.skew
    try:
        other = _begun(with_time_base(preparation.recording, "reference"), settings, progress, executor)
    except KreiselError:
        return first
    base = better_base(first.found, other.found)
    if base is None:
        return replace(first, found=with_either(first.found, other.found))
    chosen = first if base == "imu" else other
    warnings = tuple(w for w in chosen.preparation.warnings if w.subject != "clocks")
    return replace(
        chosen,
        preparation=replace(chosen.preparation, warnings=warnings),
        found=with_choice(chosen.found, base, skew),
    )


def _compared(
    found: Estimate,
    preparation: Preparation,
    given: StatedFigures,
    progress: Progress | None = None,
) -> tuple[StatedValue, ...]:
    """Return what the user states of single parameters and groups, compared with an estimate without it.

    Parameters
    ----------
    found
        The estimate with what is stated.
    given
        Whose noise figures the user gave.
    """
    settings = without_stated(found.problem.settings)
    if settings == found.problem.settings:
        return ()
    free = build_problem(preparation, settings)
    try:
        alone = estimate(free, given, estimator_for(free), progress)
    except EstimationError:
        return ()
    return stated_values(found, with_unestimated_errors(alone))

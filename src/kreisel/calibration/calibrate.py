"""From a recording to a calibration: all steps in their order."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from kreisel.calibration.assembly import Judged, assemble
from kreisel.calibration.cross_validation import cross_validate
from kreisel.calibration.evidence import Evidence
from kreisel.calibration.inflation import with_doubtful_latitude, with_unestimated_errors, with_walked_deviations
from kreisel.calibration.interval_check import with_interval_disagreement
from kreisel.calibration.latitude_check import check_latitude
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.calibration.split_halves import split_halves, with_disagreement
from kreisel.calibration.verdict import consistency, judge
from kreisel.filtering.estimate import without_passing
from kreisel.filtering.iteration import Given, estimate
from kreisel.filtering.observability import observability
from kreisel.model.known import place_of
from kreisel.model.problem import Problem
from kreisel.model.settings import CalibrationSettings
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.plausibility import check_start_values
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.progress import Progress, Together, of_parts, one_by_one
from kreisel.recording.recording import Recording


def calibrate(recording: Recording, settings: CalibrationSettings | None = None) -> Calibration:
    """Return the calibration of a recording.

    Raises
    ------
    KreiselError
        If the recording cannot be used; the message says what, where and what to do.
    """
    return run_calibration(recording, settings or CalibrationSettings()).calibration


def run_calibration(
    recording: Recording,
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    together: Together = one_by_one,
    validate: bool = False,
) -> Outcome:
    """Return the calibration of a recording with all intermediate results.

    Parameters
    ----------
    progress
        Called with the name of the step and the share of it that is done.
    together
        Does checks that do not depend on each other.
    validate
        Whether to cross-validate, too.
    """
    if progress is not None:
        progress("synchronise", 0.0)
    settings = settings.with_stated(recording.settings.fixed, recording.settings.prior)
    preparation = prepare_recording(recording, settings, together)
    check_start_values(preparation)
    problem = build_problem(preparation, settings)
    began = time.perf_counter()
    table = recording.settings.reference
    stated = table.position_sd is not None or table.orientation_sd is not None
    given = Given(stated, preparation.imu_noise.given)
    found = with_unestimated_errors(estimate(problem, given, progress, together))
    seconds = time.perf_counter() - began
    halves = split_halves(found, progress, together)
    found = with_interval_disagreement(found, progress)
    shares = of_parts(progress, "checks", 2 if validate else 1)
    latitude, *crossed = together(
        [
            partial(check_latitude, found.problem, found.run, shares[0]),
            *(partial(cross_validate, found, share) for share in shares[1:]),
        ]
    )
    found = with_disagreement(without_passing(found), halves)
    seen = observability(found.problem, found.run)
    found = with_doubtful_latitude(with_walked_deviations(found), latitude)
    seen = replace(seen, posterior=found.run.belief.standard_deviation[: len(seen.names)])
    facts = consistency(found, preparation.correlation)
    known = _known_scores(preparation, settings, problem, given, progress)
    verdict = judge(found, Evidence(seen, facts, halves, latitude, known))
    warnings = (*recording.warnings, *preparation.warnings, *found.warnings)
    calibration = assemble(preparation.recording, found, Judged(seen, facts, verdict, seconds), warnings)
    return Outcome(
        recording, preparation, found.problem, found, seen, facts, halves, verdict, warnings, calibration, *crossed
    )


def _known_scores(
    preparation: Preparation,
    settings: CalibrationSettings,
    problem: Problem,
    given: Given,
    progress: Progress | None = None,
) -> Mapping[str, float]:
    """Return how far an estimate without stated priors lies from each of them, in standard deviations.

    Parameters
    ----------
    problem
        The problem with the stated priors.
    given
        Whose noise figures the user gave.
    """
    stated = [(name, sd) for name, value, sd in settings.priors_given if sd > 0.0 and value is not None]
    if not stated:
        return {}
    fixed = tuple(one for one in settings.priors_given if one[2] == 0.0)
    free = build_problem(preparation, replace(settings, priors=fixed))
    found = with_unestimated_errors(estimate(free, given, progress))
    layout, deviation = found.problem.layout, found.run.belief.standard_deviation
    scores = {}
    for name, sd in stated:
        group, index = place_of(name, settings.polynomial_order)
        if group in layout:
            far = found.run.parameters.stored(group)[index] - problem.prior.value.stored(group)[index]
            scores[name] = abs(float(far)) / float(deviation[layout[group]][index] ** 2 + sd**2) ** 0.5
    return scores

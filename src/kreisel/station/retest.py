"""The rule for units that are tested again: repeating until it fits is no test."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from kreisel.batch.attempt import Attempt
from kreisel.batch.job_result import Run
from kreisel.batch.lot import Unit
from kreisel.batch.outcomes import OUTCOMES
from kreisel.calibration.limits import COVERAGE, Decision, Limits, QuantityDecision, decided
from kreisel.calibration.repeatability import quantities_compared

DECISIVE = tuple(outcome for outcome in OUTCOMES if outcome != "failed")
"""Outcomes that say something of the unit; the others leave it untested."""


DAYS = 30.0
"""Days within which tests of a unit are repetitions; what is older is an earlier calibration. Chosen: no unit is
calibrated again as soon, and none waits as long for its second test."""


def recent_tests(attempts: Sequence[Attempt], now: datetime) -> list[Attempt]:
    """Return the attempts at a unit that count as tests of it now."""
    return [
        one for one in attempts
        if one.kind == "unit" and one.outcome in DECISIVE
        and now - datetime.fromisoformat(one.begun) < timedelta(days=DAYS)
    ]  # fmt: skip


def outcome_of(unit: Unit, earlier: Sequence[Run], limits: Limits | None) -> tuple[str, str]:
    """Return the outcome of a unit and, where it is due to earlier tests, why.

    A unit that was tested before conforms only if the mean of all its accepted calibrations, weighted by their
    information, does too: the luckiest of several says too little.
    """
    others = [run for run in earlier if run.accepted]
    if limits is None or unit.outcome != Decision.CONFORMS.value or not others:
        return unit.outcome, ""
    parts = [run.parts for run in (*others, unit.run) if run.parts is not None]
    common = [one for one in unit.judged if one.limited and all(one.quantity.name in p.derived for p in parts)]
    found = {one.name: one for one in quantities_compared([p.derived for p in parts], [one.quantity for one in common])}
    for one in common:
        mean, sd = found[one.quantity.name].mean, found[one.quantity.name].mean_sd
        decisions = _decisions(one, mean, sd)
        for decision in (Decision.FAILS, Decision.UNDECIDED):
            if decision in decisions:
                worst = int(np.argmax(np.abs(mean) / one.limits))
                return decision.value, (
                    f"{one.quantity.title}: the mean of {len(parts)} tests, {mean[worst]:.4g} ± "
                    f"{COVERAGE * sd[worst]:.2g} {one.quantity.unit}, is not within ± {one.limits[worst]:.4g}"
                )
    return unit.outcome, ""


def _decisions(one: QuantityDecision, mean: np.ndarray, sd: np.ndarray) -> list[Decision | None]:
    return [decided(x, COVERAGE * s, most) for x, s, most in zip(mean, sd, one.limits, strict=True)]

"""Whether a result is within limits: what is said of it, and the exit status.

0 if all conform, 1 for a failure, 3 if a result is rejected or does not conform, 4 if no decision can be made; of
several the first of 1, 3, 4, 0 that occurs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from kreisel.batch.outcomes import REJECTED, UNDECIDED

if TYPE_CHECKING:
    from kreisel.calibration.limits import Decision, Limits, QuantityDecision
    from kreisel.calibration.result_sections import CalibrationParts


def status_of(parts: CalibrationParts, decision: Decision | None) -> int:
    """Return the exit status of one result; the decision is None where there are no limits."""
    from kreisel.calibration.limits import Decision

    if not parts.verdict.accepted or decision is Decision.FAILS:
        return REJECTED
    return UNDECIDED if decision is Decision.UNDECIDED else 0


def conformity(parts: CalibrationParts, limits: Limits) -> tuple[list[QuantityDecision], Decision]:
    """Return the quantities that have a limit, and the decision on all of them together.

    Raises
    ------
    SettingsError
        If the result does not have a quantity that a limit is stated for.
    """
    from kreisel.calibration.limits import Decision, judged, overall
    from kreisel.errors import SettingsError

    found = [one for one in judged(parts, limits) if one.limited]
    missing = set(limits.values) - {one.quantity.name for one in found}
    if missing:
        raise SettingsError(f"limits.{min(missing)}: this calibration does not have it; leave the limit out")
    return found, overall(found) or Decision.UNDECIDED


def as_table(judged: Sequence[QuantityDecision], decision: Decision, limits: Limits) -> dict[str, Any]:
    """Return the decisions for the JSON object of a result."""
    return {
        "limits": limits.grade or limits.file,
        "decision": decision.value,
        "quantities": {one.quantity.name: one.decision.value for one in judged if one.decision is not None},
    }


def sentence(judged: Sequence[QuantityDecision], decision: Decision) -> str:
    """Return the decision in one line, with the quantities that it is due to."""
    from kreisel.calibration.limits import Decision

    if decision is Decision.CONFORMS:
        return "conformity: conforms"
    due = ", ".join(one.quantity.title.lower() for one in judged if one.decision is decision)
    return f"conformity: {decision.value}: {due}"

"""What a program that tests units reads: one small JSON object for each, schema kreisel/unit/1."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from kreisel._version import __version__
from kreisel.batch.lot import Unit, label_of, title_of
from kreisel.batch.outcomes import STATUS
from kreisel.calibration.limits import COVERAGE, Limits

SCHEMA = "kreisel/unit/1"
"""A new number for every change that takes something away; keys may be added to one. See unit-schema.json."""

NAME = "unit.json"
"""Its file, in the result's folder."""


def unit_document(
    unit: Unit, limits: Limits | None, report: str | None = None, decided: tuple[str, str] | None = None
) -> dict[str, Any]:
    """Return outcome, exit status and figures of a unit as plain data; numbers that are not finite are None.

    Parameters
    ----------
    report
        Path of its report, relative to the document.
    decided
        Outcome and reason where more is known than this run: earlier tests of the unit.
    """
    run = unit.run
    outcome, reason = decided or (unit.outcome, "")
    return {
        "schema": SCHEMA,
        "software": f"kreisel {__version__}",
        "unit": run.unit,
        "maker": run.maker,
        "type": run.type,
        "recording": run.name,
        "date": run.date,
        "outcome": outcome,
        "status": STATUS.get(outcome, 0),
        "error": run.error,
        "reasons": [reason] if reason else reasons_of(unit),
        "outliers": [one.text for one in unit.outliers],
        "limits": None if limits is None else {"source": limits.grade or limits.file, "coverage_factor": COVERAGE},
        "figures": _figures(unit),
        "report": report,
    }


def reasons_of(unit: Unit) -> list[str]:
    """Return why a unit is not good, a sentence each; nothing for a good one."""
    run = unit.run
    if run.parts is None:
        return [run.error or "no result"]
    if not run.accepted:
        return list(run.parts.verdict.reasons)
    if unit.outcome not in STATUS:
        return []
    return [
        f"{title_of(one.quantity, axis)}: {value:.4g} ± {uncertainty:.2g} {one.quantity.unit}, "
        f"limit ± {limit:.4g}: {decision.value}"
        for one in unit.judged
        for axis, (value, uncertainty, limit, decision) in enumerate(
            zip(one.values, one.uncertainties, one.limits, one.decisions, strict=True)
        )
        if decision is not None and decision.value == unit.outcome
    ]


def _figures(unit: Unit) -> list[dict[str, Any]]:
    return [
        {
            "name": one.quantity.name,
            "axis": label_of(one.quantity, axis),
            "unit": one.quantity.unit,
            "value": _finite(one.values[axis]),
            "expanded_uncertainty": _finite(one.uncertainties[axis]),
            "observable": one.observable,
            "limit": _finite(one.limits[axis]),
            "decision": None if (decision := one.decisions[axis]) is None else decision.value,
        }
        for one in unit.judged
        for axis in range(3)
    ]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_unit(
    unit: Unit, limits: Limits | None, folder: Path, report: str | None = None, decided: tuple[str, str] | None = None
) -> None:
    """Write the document of a unit into its result's folder, which is made where there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(unit_document(unit, limits, report, decided), indent=1, ensure_ascii=False)
    (folder / NAME).write_text(text + "\n", encoding="utf-8")

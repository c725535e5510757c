"""Conversion of the compiled filter's record of its updates into a history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from kreisel._kernels.filter_arguments import Record
from kreisel.fitting.update_history import History
from kreisel.geometry.rotation import Array, conjugate, log, multiply
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update


def history_of(problem: Problem, updates: Sequence[Update], record: Record) -> History:
    """Return the history of some updates; its estimates are the parameters as they are stored."""
    reference = problem.reference
    at_standstill = np.array([item.standstill is not None for item in updates])
    given = 3 * ((reference.positions is not None) + (reference.quaternions is not None))
    return History(
        seconds=problem.sensor.readings.stamps[[item.last for item in updates]],
        parameters=record.mean,
        deviations=record.deviation,
        at_standstill=at_standstill,
        used=record.used,
        nis=record.nis,
        degrees=given + 3.0 * at_standstill,
        log_likelihood=record.log_likelihood,
        whitened=record.whitened,
        innovation=record.innovation,
        residual=record.residual,
        noise_variance=record.noise_variance,
        passing=record.passing,
        late=record.late,
        correction=record.correction,
        correction_variance=record.correction_variance,
        turn_information=record.turn_information,
    )


def joined(problem: Problem, parts: Sequence[History], last: Array) -> History:
    """Return the histories of all parts as one; its estimates have one number for each degree of freedom.

    Those of the alignment are distances from `last`, the final stored state (size,).
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

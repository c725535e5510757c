"""The estimate after all passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kreisel.filtering.history import FilterRun
from kreisel.geometry.rotation import Array
from kreisel.model.groups import group_named
from kreisel.model.problem import Problem
from kreisel.recording.recording import DataWarning


@dataclass(frozen=True)
class Considered:
    """An effect that was considered.

    Attributes
    ----------
    group
        Its parameters.
    value, deviation : (k,)
        Its estimate, together with the effects that are estimated; as stored.
    gain
        Logarithm of the ratio of the evidences of the data with and without it.
    included
        Whether it is part of the model.
    shift
        Largest change of a sensor's parameter by including it, in standard deviations without it.
    shifted
        Name of that parameter.
    """

    group: str
    value: Array
    deviation: Array
    gain: float
    included: bool
    shift: float
    shifted: str


@dataclass(frozen=True)
class Estimate:
    """Final problem (with the noise finally assumed), the run over it, and the warnings about both.

    The belief's factor is already multiplied by `correlation_factor`. `contradiction` is the largest factor
    by which given noise figures had to be raised; 1 if none were given or none had to be raised. `moved` is the
    largest change of a parameter by the last pass, in standard deviations; 0 if one pass was enough. `considered` are
    all effects beyond the usual ones, found or not; `walks` the groups that walk, and what that gains in
    log-likelihood; `contradicted` the offsets whose stated prior had to be widened, with their scores; `stated` the
    problem as it was stated.
    """

    problem: Problem
    run: FilterRun
    passes: int
    correlation_factor: float
    contradiction: float
    moved: float
    warnings: tuple[DataWarning, ...]
    considered: tuple[Considered, ...] = ()
    walks: Mapping[str, float] = field(default_factory=dict)
    contradicted: Mapping[str, float] = field(default_factory=dict)
    stated: Problem | None = None


def describe(effect: Considered) -> str:
    """Return an effect with its largest value, in the unit it is shown in."""
    group = group_named(effect.group)
    values = effect.value / group.size
    largest = float(values[int(np.argmax(np.abs(values)))])
    deviation = float(effect.deviation[int(np.argmax(np.abs(values)))]) / group.size
    which = "up to " if values.size > 1 else ""
    return f"{group.meaning.split(',')[0]}, {which}{largest:.3g} +- {deviation:.2g} {group.unit}"

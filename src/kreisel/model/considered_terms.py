"""Effects that were considered, whether or not they are part of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.model.groups import group_named

MIN_GAIN = 6.0
"""Minimum logarithm of the ratio of evidences with which an effect is estimated: 1 : 400."""

USUAL_ODDS = 1.0 / 20.0
"""Odds, before any look at the data, that a device has an effect. Chosen: one in a list of twenty."""


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


def describe(effect: Considered) -> str:
    """Return an effect with its largest value, in the unit it is shown in."""
    group = group_named(effect.group)
    values = effect.value / group.size
    largest = float(values[int(np.argmax(np.abs(values)))])
    deviation = float(effect.deviation[int(np.argmax(np.abs(values)))]) / group.size
    which = "up to " if values.size > 1 else ""
    return f"{group.meaning.split(',')[0]}, {which}{largest:.3g} ± {deviation:.2g} {group.unit}"

"""What the user states of parameters, compared with an estimate that does not use it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kreisel.calibration.evidence import StatedValue
from kreisel.fitting.stored_state import stored_state
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.refinement.estimate import Estimate


def without_stated(settings: CalibrationSettings) -> CalibrationSettings:
    """Return settings by which all is estimated that is fixed, and nothing has a prior of the user's."""
    return replace(settings, fixed=(), fixed_values=(), priors=())


def stated_values(found: Estimate, free: Estimate) -> tuple[StatedValue, ...]:
    """Return what the user states of parameters, beside what the data say; of a fixed group, what differs most.

    found, free: the estimates with what is stated and without it.
    """
    problem, settings = free.problem, found.problem.settings
    layout, names = problem.layout, problem.parameter_names
    estimated = stored_state(problem, free.run.parameters)[:, None]
    from_value, from_prior = (
        layout.minus(estimated, stored_state(problem, _complete(stated, free.run.parameters)))[:, 0]
        for stated in (found.run.parameters, found.problem.prior.value)
    )

    def values() -> Iterator[StatedValue]:
        for name, value, sd in settings.priors:
            if name in names and (sd == 0.0 or value is not None):
                i = names.index(name)
                difference = (from_prior if sd > 0.0 else from_value)[i]
                yield StatedValue(name, sd, float(difference), float(free.deviation[i]))
        for group in settings.fixed:
            if group in layout and layout[group].stop > layout[group].start:
                part = layout[group]
                own = [
                    StatedValue(name, 0.0, float(difference), float(deviation))
                    for name, difference, deviation in zip(
                        names[part], from_value[part], free.deviation[part], strict=True
                    )
                ]
                yield max(own, key=lambda one: one.score)

    return tuple(values())


def _complete(parameters: CellParameters, other: CellParameters) -> CellParameters:
    """Return parameters with zeros for groups that only the other ones have."""
    own = {group: (parameters.stored(group), other.stored(group)) for group in GROUPS}
    return CellParameters.from_stored({g: one if one.size else np.zeros_like(two) for g, (one, two) in own.items()})

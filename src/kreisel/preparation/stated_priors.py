"""What the user knows of single parameters, in the prior and in the start of the filter.

Parameters that are fixed are not in the state: others are known given their values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import SettingsError
from kreisel.estimation.state import StateLayout
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import GROUPS, CellParameters
from kreisel.model.problem import Prior
from kreisel.model.stated_parameters import place_of, with_marginal, with_observed
from kreisel.preparation.preparation import Preparation
from kreisel.synchronization.clock import Clock


def apart(preparation: Preparation) -> float:
    """Return what a time offset between stamps, as in the result, is more than that from first sample to first pose."""
    first = int(preparation.recording.imu.stamps_ns[0]), int(preparation.reference.stamps_ns[0])
    return Clock(0.0).offset(*first)


def with_known(prior: Prior, preparation: Preparation, settings: CalibrationSettings, layout: StateLayout) -> Prior:
    """Return the prior of what is in the state, with what the user knows of single parameters.

    layout: the state with those that are fixed.

    Raises
    ------
    SettingsError
        If one of them is not estimated in this recording.
    """
    places: dict[str, list[tuple[int, float | None, float]]] = {}
    for name, value, deviation in settings.priors:
        group, index = place_of(name, settings.polynomial_order)
        if group not in layout or index >= layout.whole(group):
            raise SettingsError(f"'{name}' has a prior or a value, but is no parameter of this recording")
        if value is not None and group == "time_offset":
            value -= apart(preparation)
        places.setdefault(group, []).append((index, value, deviation))
    start, centre = ({g: p.stored(g) for g in GROUPS} for p in (prior.start, prior.value))
    start_covariance, covariance, width = dict(prior.start_covariance), dict(prior.covariance), dict(prior.width)
    for group, known in places.items():
        chosen = np.array([i for i, _, _ in known], dtype=np.int64)
        values = np.array([start[group][i] if value is None else value for i, value, _ in known])
        stated = np.array([deviation for _, _, deviation in known])
        centre[group], covariance[group] = with_marginal(centre[group], covariance[group], chosen, values, stated)
        start[group], start_covariance[group] = with_observed(
            start[group], start_covariance[group], chosen, values, stated
        )
        present = np.setdiff1d(np.arange(len(covariance[group])), chosen[stated == 0.0])
        if group in width:
            width[group] = np.resize(width[group], len(covariance[group]))[present]
        for P in (covariance, start_covariance):
            P[group] = P[group][np.ix_(present, present)]
    return replace(
        prior,
        start=CellParameters.from_stored(start),
        start_covariance=start_covariance,
        value=CellParameters.from_stored(centre),
        covariance=covariance,
        width=width,
    )

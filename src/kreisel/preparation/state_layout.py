"""The state of the filter for what is to be estimated."""

from __future__ import annotations

from kreisel.estimation.state import StateLayout
from kreisel.model.calibration_settings import BY_CHOICE, CalibrationSettings
from kreisel.model.groups import REGISTRY
from kreisel.model.layout import STANDSTILL_ERROR, group_part, with_coloured_noise
from kreisel.model.parameters import PASSING_GROUPS


def build_layout(
    settings: CalibrationSettings,
    *,
    latitude: bool,
    skew: bool,
    standstill_error: bool,
    path_error: tuple[bool, bool] = (False, False),
    joints: int = 0,
    gauss_markov: tuple[str, ...] = (),
) -> StateLayout:
    """Return the layout: sensor parameters, cell parameters, the robot's errors, errors of the reference, navigation.

    Parameters
    ----------
    latitude
        Whether the latitude is given.
    skew
        Whether the ratio of the clocks is estimated.
    standstill_error
        Whether there are standstills, each with an error of its own.
    path_error
        Whether there is coloured noise in position and in orientation.
    joints
        Of the robot whose errors are estimated; 0 without one.
    gauss_markov
        Groups of passing changes of offsets.
    """
    absent = (
        set(settings.fixed) | (set(BY_CHOICE) - set(settings.estimated)) | (set(PASSING_GROUPS) - set(gauss_markov))
    )
    if latitude or "north" in absent:
        absent.add("earth_down")
    if not skew:
        absent.add("time_skew")
    order, fixed = settings.polynomial_order, settings.fixed_parameters
    parts = [group_part(g.name, order, joints, fixed) for g in REGISTRY if g.name not in absent]
    parts = [part for part in parts if part.degrees > 0]
    return with_coloured_noise(StateLayout([*parts, *(STANDSTILL_ERROR if standstill_error else ())]), path_error)

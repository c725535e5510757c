"""A rotation about the vertical that is not the Earth's as stated: it looks like gyros that respond to gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.latitude_check import SEEN
from kreisel.geometry.rotation import Array
from kreisel.inertial.earth import EARTH_RATE
from kreisel.refinement.turning_reference import same_in_all_axes
from kreisel.static.multi_position import StaticEstimate

_MIMICS = "gyro_g_sensitivity"

_CLEAR, _SURE = 4.5, 5.0
"""Deviations from zero of what all axes have in common, and logarithm of the ratio of evidences above which they have
it not by chance. Chosen: once in 100 000 recordings, and as for the stated latitude in `calibrate`."""

_REACH = 3.0
"""Deviations by which a rotation may exceed the Earth's, and still be a part of it."""


@dataclass(frozen=True)
class VerticalTurn:
    """A rotation about the vertical, beyond that of the Earth as stated.

    Attributes
    ----------
    rate
        rad/s, upwards.
    stated_deg, found_deg, latitude_sd_deg
        Stated latitude, and that by which it would be the Earth's with its deviation; None if it is no part of the
        Earth's rotation, if that is not seen well enough, or if no latitude is stated.
    """

    rate: float
    stated_deg: float | None = None
    found_deg: float | None = None
    latitude_sd_deg: float | None = None

    @property
    def reason(self) -> str:
        """Why the result may not be used; empty where it may."""
        if self.found_deg is None:
            return ""
        return (
            f"the stated latitude of {self.stated_deg:.4g} deg contradicts the Earth's rotation in the gyros' "
            f"readings, which gives {self.found_deg:.3g} ± {self.latitude_sd_deg:.2g} deg: correct site.latitude_deg "
            "in recording.toml, or state none if the device takes the Earth's rotation out of its readings"
        )

    @property
    def remark(self) -> str:
        """What to know of it, if it is no reason against the result."""
        return (
            f"all gyros respond to gravity alike, as if the place turned about the vertical by {self.rate:.2g} rad/s "
            "beyond the Earth's rotation as stated; their g-sensitivity is uncertain by as much"
        )


def vertical_turn(found: StaticEstimate) -> VerticalTurn | None:
    """Return a rotation about the vertical that the gyros' response to gravity hides; None where there is none."""
    layout = found.problem.layout
    if _MIMICS not in layout or not np.ptp(found.problem.imu.rates, axis=0).all():  # a gyro that is dead sees nothing
        return None
    d = layout[_MIMICS]
    value = found.problem.values(found.parameters)[d]
    if value.size != 9:
        return None
    P = found.covariance[d, d]
    diagonal = np.eye(3).ravel() / 3.0
    gravity = found.parameters.gravity
    # a response corrects readings: it takes from them what they have too much
    rate, deviation = -gravity * float(diagonal @ value), gravity * float(np.sqrt(diagonal @ P @ diagonal))
    prior = np.diag(found.problem.width[d] ** 2)
    if abs(rate) < _CLEAR * deviation or same_in_all_axes(value, P, prior) < _SURE:
        return None
    if found.problem.site.earth_rate_n is None:
        return VerticalTurn(rate)
    stated = -float(found.problem.site.earth_rate_n[2]) / EARTH_RATE
    sine, sd = stated + rate / EARTH_RATE, deviation / EARTH_RATE
    if sd > SEEN or abs(sine) > 1.0 + _REACH * sd:
        return VerticalTurn(rate)
    latitude = float(np.arcsin(np.clip(sine, -1.0, 1.0)))
    uncertain = sd / max(float(np.cos(latitude)), np.sqrt(sd))
    return VerticalTurn(
        rate, float(np.degrees(np.arcsin(stated))), float(np.degrees(latitude)), float(np.degrees(uncertain))
    )


def effect_of_vertical(turn: VerticalTurn | None, found: StaticEstimate) -> Array:
    """Return what such a rotation does to the parameters if it is one, (P, 1)."""
    out = np.zeros((found.problem.layout.degrees, 1))
    if turn is not None:
        out[found.problem.layout[_MIMICS], 0] = turn.rate / found.parameters.gravity * np.eye(3).ravel()
    return out

"""The verdict of a unit of a tray: that of the mean, and what the unit's own readings say against it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from kreisel.array.mount_watch import Turn
from kreisel.calibration.result_sections import Verdict
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.preparation.axis_order import LEFT_HANDED_GYROS, disorder, turn_between

_OFTEN = 0.1
"""Share of a recording in which readings that are far off are a reason against a unit. Chosen: bursts, spikes and lost
contacts are rarer; what errs more often errs as the motion does."""


@dataclass(frozen=True)
class UnitFindings:
    """What is found of a unit.

    Attributes
    ----------
    turn
        Of the unit on its mount.
    sure
        Whether it was this unit that turned, and not the other one.
    odd
        By how much its differences from the common motion exceed its noise, where the mean is better without it.
    far
        Share of the recording in which its readings are far off.
    shown
        Effects that its readings show and that are not estimated: they cannot be, or the mean is rejected with them.
    sensors
        Its parameters.
    """

    turn: Turn | None
    sure: bool
    odd: float | None
    far: float
    shown: Collection[str]
    sensors: SensorParameters


def unit_verdict(verdict: Verdict, found: UnitFindings) -> Verdict:
    """Return the verdict of a unit, by that of the mean."""
    reason = _reason(found)
    if reason is None:
        return verdict
    sensors = dict.fromkeys(verdict.sensors, "rejected")
    return replace(verdict, accepted=False, reasons=(*verdict.reasons, reason), sensors=sensors)


def _reason(found: UnitFindings) -> str | None:
    """Return the reason against a unit, if there is one."""
    if found.turn is not None:
        angle = 1e3 * float(np.linalg.norm(found.turn.angle))
        when = f"{found.turn.seconds:.0f} s after the beginning"
        if found.sure:
            return f"it turned on its mount by {angle:.2g} mrad, {when}; fasten it"
        return f"it or the other unit turned on its mount, by {2.0 * angle:.2g} mrad, {when}; fasten both"
    if found.odd is not None:
        return (
            f"its readings differ from the motion of the other units by {found.odd:.2g} times what its noise explains; "
            "check its mount, its clock and its connection"
        )
    if found.far > _OFTEN:
        return (
            f"its readings differ grossly from the motion of the other units for {100.0 * found.far:.0f} % of the "
            "recording; check its range, its mount and its connection"
        )
    if found.shown:
        return (
            f"its readings show {' and '.join(found.shown)}, and no calibration of the mean accounts for that; check "
            "its mount, or calibrate it alone with --imu"
        )
    if np.linalg.det(found.sensors.K_omega) < 0.0:
        return LEFT_HANDED_GYROS
    return disorder(turn_between(found.sensors.K_omega, found.sensors.K_a))

"""Where the units of a tray lie against the first one, and covariances of all units together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kreisel.array.relative_pose import RelativePose, pose_derivatives
from kreisel.array.tray_result import mover_of, own_covariance
from kreisel.calibration.device_axes import NAMES
from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array

if TYPE_CHECKING:
    from kreisel.array.tray_outcome import UnitOutcome

_EACH = len(NAMES)


def covariance_of_units(mean: Calibration, units: Sequence[UnitOutcome]) -> Array:
    """Return the covariance (33 N, 33 N) of the parameters `NAMES` of all units, one after the other.

    Parameters
    ----------
    mean
        The calibration by which all units were calibrated.

    Notes
    -----
    What is known of a unit's own noise is the covariance of differences from the mean, which is smaller for a unit that
    is a part of it. What noise of the mean does is the same for all units, and is in the covariance of its calibration.
    """
    n, own = mover_of(mean)[1], [own_covariance(unit.fit) for unit in units]
    by_mean = np.vstack([by_mean for _, by_mean in own])
    blocks = [R / max(1.0 - float(np.mean(unit.share)), 1e-9) for unit, (R, _) in zip(units, own, strict=True)]
    covariance = by_mean @ mean.covariance[:n, :n] @ by_mean.T
    for k, block in enumerate(blocks):
        own_part = slice(_EACH * k, _EACH * (k + 1))
        covariance[own_part, own_part] += block
    return np.asarray(0.5 * (covariance + covariance.T))


def places_of_units(units: Sequence[UnitOutcome], joint: Array) -> tuple[dict[str, RelativePose], Array]:
    """Return the places of the further units by name, and the covariance (6 k, 6 k) of all k of them.

    joint: covariance of all units' parameters.
    """
    base, size = units[0].calibration.sensors, 6 * (len(units) - 1)
    found = [pose_derivatives(base, unit.calibration.sensors) for unit in units[1:]]
    J = np.zeros((size, _EACH * len(units)))
    for k, (_, _, rows) in enumerate(found):
        J[6 * k : 6 * k + 6, :_EACH] = rows[:, :_EACH]
        J[6 * k : 6 * k + 6, _EACH * (k + 1) : _EACH * (k + 2)] = rows[:, _EACH:]
    covariance = J @ joint @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    poses = {
        unit.name: RelativePose(position, rotation, covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
        for k, (unit, (position, rotation, _)) in enumerate(zip(units[1:], found, strict=True))
    }
    return poses, covariance

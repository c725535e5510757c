"""Where the units of a tray lie against the first one, and the covariance of all places together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag

from kreisel.array.relative_pose import RelativePose, pose_derivatives
from kreisel.array.tray_result import mover_of, own_covariance
from kreisel.calibration.device_axes import NAMES
from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array

if TYPE_CHECKING:
    from kreisel.array.tray_outcome import UnitOutcome

_EACH = len(NAMES)


def places_of_units(mean: Calibration, units: Sequence[UnitOutcome]) -> tuple[dict[str, RelativePose], Array]:
    """Return the places of the further units by name, and the covariance (6 k, 6 k) of all k of them.

    Parameters
    ----------
    mean
        The calibration by which all units were calibrated.
    """
    P, own = mean.covariance, [own_covariance(unit.fit) for unit in units]
    n, base, size = mover_of(mean)[1], units[0].calibration.sensors, 6 * (len(units) - 1)
    found = [pose_derivatives(base, unit.calibration.sensors) for unit in units[1:]]
    J = np.zeros((size, _EACH * len(units)))
    for k, (_, _, rows) in enumerate(found):
        J[6 * k : 6 * k + 6, :_EACH] = rows[:, :_EACH]
        J[6 * k : 6 * k + 6, _EACH * (k + 1) : _EACH * (k + 2)] = rows[:, _EACH:]
    of_mean = J @ np.vstack([by_mean for _, by_mean in own])
    covariance = of_mean @ P[:n, :n] @ of_mean.T + J @ _own(units, [R for R, _ in own]) @ J.T
    covariance = 0.5 * (covariance + covariance.T)
    poses = {
        unit.name: RelativePose(position, rotation, covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
        for k, (unit, (position, rotation, _)) in enumerate(zip(units[1:], found, strict=True))
    }
    return poses, covariance


def _own(units: Sequence[UnitOutcome], own: Sequence[Array]) -> Array:
    """Return the covariance (33 N, 33 N) of what is not common to all units: that of each one's own noise.

    What is known is the covariance of differences from the mean, which is smaller for a unit that is a part of it. What
    the mean errs by is the same for all units, and no error of places against each other.
    """
    blocks = [R / max(1.0 - float(np.mean(unit.share)), 1e-9) for unit, R in zip(units, own, strict=True)]
    return np.asarray(block_diag(*blocks))

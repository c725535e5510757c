"""Where two units lie against each other, by the frames of their accelerometers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.calibration.device_axes import linearised
from kreisel.geometry.rotation import Array, from_matrix, log, skew
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.synchronization.clock import Clock


@dataclass(frozen=True)
class RelativePose:
    """Frame of one unit in the frame of the reference unit; see `device_axes.AXES`, imu.

    Attributes
    ----------
    position : (3,)
        Of the middle of its accelerometers, m.
    rotation : (3, 3)
        Turns a vector from its axes to those of the reference unit.
    covariance : (6, 6)
        Of position, m, and of a rotation vector in axes of the reference unit, rad.
    """

    position: Array
    rotation: Array
    covariance: Array

    @property
    def document(self) -> dict[str, Any]:
        """What `array.yaml` says of it."""
        sd = np.sqrt(np.diag(self.covariance))
        return {
            "position": self.position.tolist(),
            "rotation": self.rotation.tolist(),
            "rotation_vector": log(from_matrix(self.rotation)).tolist(),
            "standard_deviation": {"position": sd[:3].tolist(), "rotation": sd[3:].tolist()},
        }


SCHEMA = "kreisel-array-1"
"""Of `array.yaml`."""

AXES = (
    "of the reference unit: z along the sensitive axis of accelerometer z, y in the plane of y and z; origin in the "
    "middle of its accelerometers; rotation turns vectors of a unit into them"
)
CLOCK = "t_reference = t + offset + skew (t - first t), stamps of the reference unit and of a unit, s"
"""What `array.yaml` says of its numbers."""


def clock_document(clock: Clock, first_reference_ns: int, first_ns: int) -> dict[str, float]:
    """Return what `array.yaml` says of a unit's clock.

    clock: seconds of the reference unit by those of the unit, each from its first sample, at these stamps.
    """
    offset = clock.offset(first_reference_ns, first_ns)
    found = {"offset": offset, "offset_sd": clock.start_sd, "skew": clock.skew, "skew_sd": clock.skew_sd}
    return {name: float(value) for name, value in found.items()}


def pose_derivatives(reference: SensorParameters, own: SensorParameters) -> tuple[Array, Array, Array]:
    """Return position (3,) and rotation (3, 3) of a unit against the reference unit, with derivatives (6, 66).

    These are of position and rotation vector as in `RelativePose`, by the parameters `device_axes.NAMES` of the
    reference unit and of the unit.
    """
    base, unit = linearised(reference, "imu"), linearised(own, "imu")
    C = base.rotation.T @ unit.rotation
    p = base.rotation.T @ (unit.origin - base.origin)
    J = np.zeros((6, 66))
    J[:3, :33] = -base.rotation.T @ base.J_mounting[3:] + skew(p) @ base.J_mounting[:3]
    J[:3, 33:] = base.rotation.T @ unit.J_mounting[3:]
    J[3:, :33] = -base.J_mounting[:3]
    J[3:, 33:] = C @ unit.J_mounting[:3]
    return p, C, J

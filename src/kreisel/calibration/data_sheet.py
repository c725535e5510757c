"""The result in the words and units of data sheets, with uncertainties carried over from the parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel.geometry.rotation import Array, from_matrix, log, nearest_rotation
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MRAD, PPM

_PAIRS = ((0, 1), (0, 2), (1, 2))


def sensitivity(K: Array) -> tuple[Array, Array]:
    """Return scale factors (3,) and unit sensitive axes (3, 3; rows, in b) of a cross-coupling matrix."""
    rows = np.linalg.inv(K)
    scale = np.linalg.norm(rows, axis=1)
    return scale, rows / scale[:, None]


def non_orthogonality(K: Array) -> Array:
    """Return by how much the angles xy, xz, yz between sensitive axes fall short of 90 degrees, rad."""
    _, axes = sensitivity(K)
    return np.array([np.arcsin(np.clip(axes[i] @ axes[j], -1.0, 1.0)) for i, j in _PAIRS])


def mounting(K: Array) -> Array:
    """Return the rotation vector (3,) from sensor axes to b, rad: the rotation nearest to K."""
    return log(from_matrix(nearest_rotation(K)))


def gyro_to_accel(K_omega: Array, K_a: Array) -> Array:
    """Return the rotation vector (3,) that turns the accelerometers' axes onto the gyros', rad."""
    return log(from_matrix(nearest_rotation(K_omega) @ nearest_rotation(K_a).T))


def distances(lever_arms: Array) -> Array:
    """Return the distances between the accelerometers xy, xz, yz, m."""
    return np.array([np.linalg.norm(lever_arms[i] - lever_arms[j]) for i, j in _PAIRS])


QUANTITIES: dict[str, Callable[[SensorParameters], Array]] = {
    "gyro_scale_ppm": lambda p: (sensitivity(p.K_omega)[0] - 1.0) / PPM,
    "accel_scale_ppm": lambda p: (sensitivity(p.K_a)[0] - 1.0) / PPM,
    "gyro_non_orthogonality_mrad": lambda p: non_orthogonality(p.K_omega) / MRAD,
    "non_orthogonality_mrad": lambda p: non_orthogonality(p.K_a) / MRAD,
    "gyro_to_accel_rotation_mrad": lambda p: gyro_to_accel(p.K_omega, p.K_a) / MRAD,
    "mounting_rotation_deg": lambda p: mounting(p.K_omega) / DEG,
    "offset_mg": lambda p: p.k_a[0] / MG,
    "offset_deg_h": lambda p: p.k_w[0] / DEG_PER_HOUR,
    "accel_distances_mm": lambda p: distances(p.lever_arms) / MM,
}
"""Derived quantities, three numbers each: axes x, y, z, or pairs of axes xy, xz, yz."""


def derive(
    parameters: SensorParameters, covariance: Array, unpack: Callable[[Array], SensorParameters]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return derived quantities and their standard deviations.

    Parameters
    ----------
    covariance : (n, n)
        Of the estimated sensor parameters.
    unpack
        Returns the parameters moved by changes (n,) of the estimated ones.
    """
    values = {name: quantity(parameters) for name, quantity in QUANTITIES.items()}
    n = covariance.shape[0]
    step = 1e-6
    moved = [(unpack(step * e), unpack(-step * e)) for e in np.eye(n)]
    deviations = {}
    for name, quantity in QUANTITIES.items():
        J = np.array([(quantity(a) - quantity(b)) / (2.0 * step) for a, b in moved]).reshape(n, 3).T
        deviations[name] = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0))
    return values, deviations

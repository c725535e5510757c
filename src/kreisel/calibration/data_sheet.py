"""The sensors' errors in the terms and units of data sheets, with uncertainties propagated from the parameters.

Parameters are corrections: they turn readings into true values. The quantities here are errors of the readings: a bias
is what a sensor reads too much at standstill, -k_0; a scale-factor error is positive for a sensor that reads too much.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kreisel.calibration.result_sections import Measured
from kreisel.geometry.rotation import Array, from_matrix, lengths, log, nearest_rotation
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.units import DEG, DEG_PER_HOUR, MG, MM, MRAD, PPM

_FIRST, _SECOND = [0, 0, 1], [1, 2, 2]  # the axes of xy, xz, yz, as the quantities list them

MAX_SCALE, MAX_SPREAD, MAX_ANGLE = 1.5, 0.15, 0.1
"""Scale factor, difference of scale factors between axes, and angle between axes less a right one (rad): no device has
more."""

_STEP = 1e-6
"""SI; step of central differences by a sensor parameter. Chosen: the square of it is the error by curvature, 1e-12, and
1e-16 over it that by rounding, 1e-10."""


def sensitivity(K: Array) -> tuple[Array, Array]:
    """Return scale factors (..., 3) and unit sensitive axes (..., 3, 3; rows, in b) of cross-coupling matrices."""
    rows = np.linalg.inv(K)
    scale = lengths(rows)
    return scale, rows / scale[..., None]


def non_orthogonality(K: Array) -> Array:
    """Return by how much the angles xy, xz, yz between sensitive axes fall short of 90 degrees, (..., 3), rad."""
    _, axes = sensitivity(K)
    return np.arcsin(np.clip(np.sum(axes[..., _FIRST, :] * axes[..., _SECOND, :], axis=-1), -1.0, 1.0))


def mounting(K: Array) -> Array:
    """Return the rotation vectors (..., 3) from sensor axes to b, rad: the rotations nearest to K."""
    return log(from_matrix(nearest_rotation(K)))


def gyro_to_accel(K_omega: Array, K_a: Array) -> Array:
    """Return the rotation vectors (..., 3) that turn the accelerometers' axes onto the gyros', along the former, rad.

    They are the device's own: the mounting cancels.
    """
    return log(from_matrix(np.swapaxes(nearest_rotation(K_a), -1, -2) @ nearest_rotation(K_omega)))


def distances(lever_arms: Array) -> Array:
    """Return the distances between the accelerometers xy, xz, yz, (..., 3), m."""
    return lengths(lever_arms[..., _FIRST, :] - lever_arms[..., _SECOND, :])


@dataclass(frozen=True)
class Quantity:
    """A derived quantity of three numbers.

    Attributes
    ----------
    name
        In the result file; it ends with the unit.
    title, unit
        As in terminal and report.
    of
        What the three numbers belong to: axes x, y, z, or pairs of axes xy, xz, yz.
    groups
        Groups of parameters it depends on.
    value
        Function of the sensor parameters, in its unit; of parameters with leading axes, it has these, too.
    """

    name: str
    title: str
    unit: str
    of: Literal["axes", "pairs"]
    groups: tuple[str, ...]
    value: Callable[[SensorParameters], Array]


_GYRO, _ACCEL = ("gyro_cross_coupling",), ("accel_cross_coupling",)

QUANTITIES: tuple[Quantity, ...] = (
    Quantity(
        "gyro_scale_error_ppm", "Gyro scale-factor error", "ppm", "axes", _GYRO,
        lambda p: (sensitivity(p.K_omega)[0] - 1.0) / PPM,
    ),
    Quantity(
        "gyro_bias_deg_h", "Gyro bias", "deg/h", "axes", ("gyro_offset",),
        lambda p: -p.k_w[..., 0, :] / DEG_PER_HOUR,
    ),
    Quantity(
        "gyro_non_orthogonality_mrad", "Gyro non-orthogonality", "mrad", "pairs", _GYRO,
        lambda p: non_orthogonality(p.K_omega) / MRAD,
    ),
    Quantity(
        "accel_scale_error_ppm", "Accelerometer scale-factor error", "ppm", "axes", _ACCEL,
        lambda p: (sensitivity(p.K_a)[0] - 1.0) / PPM,
    ),
    Quantity("accel_bias_mg", "Accelerometer bias", "mg", "axes", ("accel_offset",), lambda p: -p.k_a[..., 0, :] / MG),
    Quantity(
        "accel_non_orthogonality_mrad", "Accelerometer non-orthogonality", "mrad", "pairs", _ACCEL,
        lambda p: non_orthogonality(p.K_a) / MRAD,
    ),
    Quantity(
        "mounting_rotation_deg", "Mounting, gyro axes to b", "deg", "axes", _GYRO,
        lambda p: mounting(p.K_omega) / DEG,
    ),
    Quantity(
        "gyro_to_accel_rotation_mrad", "Accelerometer axes to gyro axes", "mrad", "axes", (*_GYRO, *_ACCEL),
        lambda p: gyro_to_accel(p.K_omega, p.K_a) / MRAD,
    ),
    Quantity(
        "accel_distances_mm", "Distance between accelerometers", "mm", "pairs", ("lever_arms",),
        lambda p: distances(p.lever_arms) / MM,
    ),
)  # fmt: skip
"""Derived quantities, in the order they are shown in."""

OF_A_REFERENCE = ("mounting_rotation_deg", "accel_distances_mm")
"""Quantities that only a reference shows: where the device sits, and its lever arms."""

OF_SCHEMA_1: dict[str, tuple[str, float]] = {
    "gyro_scale_ppm": ("gyro_scale_error_ppm", 1.0),
    "accel_scale_ppm": ("accel_scale_error_ppm", 1.0),
    "non_orthogonality_mrad": ("accel_non_orthogonality_mrad", 1.0),
    "offset_deg_h": ("gyro_bias_deg_h", -1.0),
    "offset_mg": ("accel_bias_mg", -1.0),
}
"""Names in schema 1, with the names in schema 2 and the sign between the two."""


_AGREES, _ROUNDING = 0.01, 1e-6
"""Of a standard deviation, which is half the last digit of a certificate; of the value, and in the quantity's unit."""

_MOUNTING = "mounting_rotation_deg"
"""Of half a turn there are two, so that rounding may change all of it."""


def of_parameters(
    derived: Mapping[str, Measured], parameters: SensorParameters, deviations: SensorParameters
) -> dict[str, Measured]:
    """Return derived quantities as read from a file, with the values that the parameters give.

    Parameters
    ----------
    deviations
        Of the parameters. Those of biases are these in another unit; others depend on correlations, too.

    Raises
    ------
    ValueError
        If they differ by more than rounding: then somebody changed one of them.
    """
    for name, own in (("gyro_bias_deg_h", deviations.k_w[0] / DEG_PER_HOUR), ("accel_bias_mg", deviations.k_a[0] / MG)):
        stated = derived[name].deviation if name in derived else own
        apart = np.abs(stated - own) > _AGREES * own + _ROUNDING
        if apart.any():
            k = int(np.argmax(apart))
            raise ValueError(
                f"standard_deviation.derived.{name}[{k}] is {stated[k]:.6g}, but the offset's gives {own[k]:.6g}: "
                "somebody changed one of them"
            )
    out = dict(derived)
    for quantity in QUANTITIES:
        stated = derived.get(quantity.name)
        if stated is None:
            continue
        value = np.where(np.isnan(stated.value), np.nan, quantity.value(parameters))
        apart = np.abs(stated.value - value)
        within = apart <= np.maximum(_AGREES * np.nan_to_num(stated.deviation), _ROUNDING * (1.0 + np.abs(value)))
        within |= np.isnan(stated.value)  # not determined
        if quantity.name != _MOUNTING and not within.all():
            k = int(np.argmin(within))
            raise ValueError(
                f"derived.{quantity.name}[{k}] is {stated.value[k]:.9g}, but the parameters give {value[k]:.9g}: "
                "somebody changed one of them"
            )
        out[quantity.name] = Measured(value, stated.deviation)
    return out


def derive(
    parameters: SensorParameters,
    covariance: Array,
    unpack: Callable[[Array], SensorParameters],
    unknown: Collection[str] = (),
) -> dict[str, Measured]:
    """Return derived quantities with their standard deviations, by name.

    Parameters
    ----------
    covariance : (n, n)
        Of the estimated sensor parameters.
    unpack
        Returns the parameters moved by changes (n,) of the estimated ones.
    unknown
        Groups that were neither estimated nor stated: what depends on them is NaN.
    """
    n = covariance.shape[0]
    steps = _STEP * np.vstack([np.eye(n), -np.eye(n)])
    moved = _stacked([unpack(step) for step in steps]) if n else parameters
    out = {}
    for quantity in QUANTITIES:
        if any(group in unknown for group in quantity.groups):
            out[quantity.name] = Measured(np.full(3, np.nan), np.full(3, np.nan))
            continue
        values = quantity.value(moved)
        J = (values[:n] - values[n:]).T / (2.0 * _STEP) if n else np.zeros((3, 0))
        deviation = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0))
        out[quantity.name] = Measured(quantity.value(parameters), deviation)
    return out


def _stacked(many: Sequence[SensorParameters]) -> SensorParameters:
    """Return the matrices, offsets and lever arms of many sensors along a first axis."""
    K_omega, k_w, K_a, k_a, lever_arms = (
        np.stack([getattr(one, name) for one in many]) for name in ("K_omega", "k_w", "K_a", "k_a", "lever_arms")
    )
    return SensorParameters(K_omega, k_w, K_a, k_a, lever_arms)

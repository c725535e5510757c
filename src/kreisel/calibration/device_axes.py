"""The axes a calibration is given in: those of the tool, or the device's own, with the mounting split off.

K contains the mounting: it turns readings into the axes of the body b of the reference. Once the device leaves the
tool, only its own part is of use: K_a = C_bs T_a, with C_bs the rotation from the device's frame s to b, and T_a upper
triangular. Then z of s is along the sensitive axis z, and y in the plane of the sensitive axes y and z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.result_sections import DeviceTriad, Measured
from kreisel.errors import SettingsError, unknown_name
from kreisel.geometry.rotation import Array, from_matrix, log, nearest_rotation, right_angle_turns, skew
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.parameters import parameter_names
from kreisel.units import DEG

AXES = {
    "tool": "axes and origin of b, the body whose pose the reference gives",
    "imu": "z along the sensitive axis of accelerometer z, y in the plane of those of y and z; origin in the middle of "
    "the accelerometers",
    "gyro": "z along the sensitive axis of gyro z, y in the plane of those of y and z; origin in the middle of the "
    "accelerometers",
    "nominal": "axes of b, turned by the right angles nearest to the mounting; origin in the middle of the "
    "accelerometers",
}
"""Choices of axes, and what they mean."""

MAX_FROM_NOMINAL = 15.0 * DEG
"""Largest rotation between the accelerometers' axes and the nearest right angles for `nominal`."""

_LINEAR = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset", "lever_arms")
NAMES = tuple(name for group in _LINEAR for name in parameter_names(group, 1))
"""Names of the parameters (33) that turn with the axes, in the order of `vector_of`."""

Unpack = Callable[[Array], SensorParameters]
"""From changes of the estimated parameters to the parameters."""

_K_OMEGA, _K_A = (first + np.arange(9).reshape(3, 3).T for first in (0, 12))
_ARMS, _K_W, _K_A_OFFSET = 24 + np.arange(9).reshape(3, 3), np.arange(9, 12), np.arange(21, 24)
"""Where `vector_of` has the columns of the matrices, one in each row here; the arms; the offsets."""


def vector_of(p: SensorParameters) -> Array:
    """Return the parameters that `NAMES` lists, (33,)."""
    return np.concatenate([p.K_omega.ravel(), p.k_w[0], p.K_a.ravel(), p.k_a[0], p.lever_arms.ravel()])


def with_vector(p: SensorParameters, x: Array) -> SensorParameters:
    """Return the parameters with those that `NAMES` lists replaced."""
    K_omega, k_w, K_a, k_a, arms = np.split(x, np.cumsum([9, 3, 9, 3]))
    return replace(
        p,
        K_omega=K_omega.reshape(3, 3),
        k_w=np.vstack([k_w, p.k_w[1:]]),
        K_a=K_a.reshape(3, 3),
        k_a=np.vstack([k_a, p.k_a[1:]]),
        lever_arms=arms.reshape(3, 3),
    )


def check_axes(axes: str) -> None:
    """Raise an error for axes that do not exist.

    Raises
    ------
    SettingsError
        It lists the known ones.
    """
    if axes not in AXES:
        raise SettingsError(unknown_name("axes", axes, AXES))


def upper_triangular(K: Array) -> tuple[Array, Array]:
    """Return a rotation and an upper triangular matrix (3, 3) whose product is K.

    The diagonal is positive; of a left-handed triad its last entry is negative.
    """
    Q, R = np.linalg.qr(K)
    signs = np.where(np.diag(R) < 0.0, -1.0, 1.0)
    signs[2] *= np.linalg.det(Q) * np.prod(signs)
    return Q * signs, R * signs[:, None]


def nearest_right_angles(K: Array) -> Array:
    """Return the rotation by right angles (3, 3), of the 24 there are, nearest to that of K.

    Raises
    ------
    SettingsError
        If the nearest is further away than `MAX_FROM_NOMINAL`.
    """
    C = nearest_rotation(K)
    best = max(right_angle_turns(), key=lambda turn: float(np.sum(turn * C)))
    away = float(np.linalg.norm(log(from_matrix(best.T @ C))))
    if away > MAX_FROM_NOMINAL:
        raise SettingsError(
            f"--axes nominal: the device is mounted {away / DEG:.1f} deg away from the nearest right angles, expected "
            f"{MAX_FROM_NOMINAL / DEG:.0f} at most; use --axes imu, which needs no nominal mounting"
        )
    return best


def frame_of(p: SensorParameters, axes: str) -> tuple[Array, Array]:
    """Return the rotation C_bs (3, 3) of the device's frame and its origin in b (3,), m.

    Raises
    ------
    SettingsError
        For `nominal`, where the mounting is far from right angles.
    """
    if axes == "tool":
        return np.eye(3), np.zeros(3)
    C = {"imu": lambda: upper_triangular(p.K_a)[0], "gyro": lambda: upper_triangular(p.K_omega)[0],
         "nominal": lambda: nearest_right_angles(p.K_a)}[axes]()  # fmt: skip
    return C, p.lever_arms.mean(axis=0)


def turned(p: SensorParameters, C: Array, origin: Array) -> SensorParameters:
    """Return the parameters for another frame, of rotation C and with an origin, both as seen from the present one."""
    return replace(p, K_omega=C.T @ p.K_omega, K_a=C.T @ p.K_a, lever_arms=(p.lever_arms - origin) @ C)


@dataclass(frozen=True)
class Linearised:
    """Parameters in other axes, with their derivatives by the present ones.

    Attributes
    ----------
    sensors
        In the other axes.
    rotation, origin
        C_bs (3, 3), and the origin of s in b (3,).
    J : (33, 33)
        Of `vector_of`.
    J_mounting : (6, 33)
        Of the rotation (rad, in s) and the origin.
    """

    sensors: SensorParameters
    rotation: Array
    origin: Array
    J: Array
    J_mounting: Array


def linearised(p: SensorParameters, axes: str) -> Linearised:
    """Return the parameters in other axes.

    Raises
    ------
    SettingsError
        For `nominal`, where the mounting is far from right angles.

    Notes
    -----
    With dC_bs = C_bs [rho x]: d(C^T K) = C^T dK + [k' x] rho for every column k' of C^T K, and likewise for the arms.
    """
    C, origin = frame_of(p, axes)
    own = turned(p, C, origin)
    rotation, shift = _frame_moved(own, C, axes)
    J = np.zeros((len(NAMES), len(NAMES)))
    for at in (_K_OMEGA, _K_A, _ARMS):
        J[np.ix_(at.ravel(), at.ravel())] = np.kron(np.eye(3), C.T)
    for at, vectors in ((_K_OMEGA, own.K_omega.T), (_K_A, own.K_a.T), (_ARMS, own.lever_arms)):
        J[at] += skew(vectors) @ rotation
    J[_ARMS] -= C.T @ shift
    offsets = np.concatenate([_K_W, _K_A_OFFSET])
    J[offsets, offsets] = 1.0
    return Linearised(clean(own, axes), C, origin, J, np.vstack([rotation, shift]))


def _frame_moved(own: SensorParameters, C: Array, axes: str) -> tuple[Array, Array]:
    """Return what the parameters do to the rotation (3, 33) of a frame, rad in s, and its origin (3, 33) in b.

    own: the parameters in the frame.
    """
    rotation, shift = np.zeros((3, len(NAMES))), np.zeros((3, len(NAMES)))
    if axes == "tool":
        return rotation, shift
    for arm in _ARMS:
        shift[:, arm] = np.eye(3) / 3.0
    name, at = {"imu": ("K_a", _K_A), "gyro": ("K_omega", _K_OMEGA), "nominal": ("", _K_A)}[axes]
    if name:
        # (C^T dK - [rho x] T) T^-1 is upper triangular
        inverse = np.linalg.inv(getattr(own, name))
        for k, (row, column, sign) in enumerate(((2, 1, 1.0), (2, 0, -1.0), (1, 0, 1.0))):
            rotation[k, at.ravel()] = sign * np.outer(inverse[:, column], C[:, row]).ravel()
    return rotation, shift


def clean(p: SensorParameters, axes: str) -> SensorParameters:
    """Return parameters with exact zeros below the diagonal of the triad that defines the axes."""
    name = {"imu": "K_a", "gyro": "K_omega"}.get(axes)
    return p if name is None else replace(p, **{name: np.triu(getattr(p, name))})


def device_triads(
    sensors: SensorParameters, sensor_sd: SensorParameters, names: tuple[str, ...], covariance: Array
) -> dict[str, DeviceTriad]:
    """Return the device's own triad in each choice of axes of its own that there is.

    Parameters
    ----------
    sensor_sd
        Deviations of parameters that are not among the names; not finite where they are not known.
    names, covariance
        Of the estimated parameters.
    """
    P = covariance_of(sensor_sd, names, covariance)
    out = {}
    for axes in ("imu", "gyro", "nominal"):
        try:
            found = linearised(sensors, axes)
        except SettingsError:
            continue
        sd, mounting_sd = (np.sqrt(np.maximum(np.diag(J @ P @ J.T), 0.0)) for J in (found.J, found.J_mounting))
        values, deviations = found.sensors, clean(with_vector(sensors, sd), axes)
        out[axes] = DeviceTriad(
            gyro_matrix=Measured(values.K_omega, deviations.K_omega),
            accel_matrix=Measured(values.K_a, deviations.K_a),
            lever_arms=Measured(values.lever_arms, deviations.lever_arms),
            rotation=found.rotation,
            rotation_vector=Measured(log(from_matrix(found.rotation)), mounting_sd[:3]),
            position=Measured(found.origin, mounting_sd[3:]),
        )
    return out


def covariance_of(sensor_sd: SensorParameters, names: tuple[str, ...], covariance: Array) -> Array:
    """Return the covariance (33, 33) of `NAMES`: by deviation alone for a parameter that was not estimated."""
    P = np.diag(vector_of(sensor_sd) ** 2)
    place = {name: i for i, name in enumerate(names)}
    own = [i for i, name in enumerate(NAMES) if name in place]
    index = [place[NAMES[i]] for i in own]
    P[own] = 0.0
    P[np.ix_(own, own)] = covariance[np.ix_(index, index)]
    return P


def expressed(
    sensors: SensorParameters, sensor_sd: SensorParameters, names: tuple[str, ...], covariance: Array, axes: str
) -> tuple[Linearised, tuple[str, ...], Array, Unpack]:
    """Return parameters in other axes, the names and covariance of the estimated ones, and how changes act on them.

    The names begin with `NAMES`: in other axes a parameter depends on several.

    Raises
    ------
    SettingsError
        For `nominal`, where the mounting is far from right angles.
    """
    found = linearised(sensors, axes)
    others = [i for i, name in enumerate(names) if name not in NAMES]
    place = {name: i for i, name in enumerate(names)}
    n, k = len(NAMES), len(others)
    P = np.zeros((n + k, n + k))
    P[:n, :n] = covariance_of(sensor_sd, names, covariance)
    P[n:, n:] = covariance[np.ix_(others, others)]
    for i, name in enumerate(NAMES):
        if name in place:
            P[i, n:] = P[n:, i] = covariance[place[name], others]
    T = np.eye(n + k)
    T[:n, :n] = found.J

    def unpack(change: Array) -> SensorParameters:
        return with_vector(found.sensors, vector_of(found.sensors) + change[:n])

    return found, (*NAMES, *(names[i] for i in others)), T @ P @ T.T, unpack

"""Kalibr's model of an IMU, which OpenVINS shares, and its tables in YAML.

Kalibr's models turn true values into readings, in a frame i in which M of the accelerometers is lower triangular:

    a = M (C_i_b f + ...) + b,    w = M_w C_gyro_i C_i_b omega + A C_gyro_i C_i_b f + b

with b = -k_0 added last, in raw units. Source: IccSensors.py of ethz-asl/kalibr.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel.calibration.device_axes import turned
from kreisel.errors import RecordingError
from kreisel.exchange.losses import without_effects_of
from kreisel.files import MAX_YAML, check_entries, read_text
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters

_ORTHOGONAL = 1e-4
"""Largest deviation of a written rotation times its transpose from the identity."""


@dataclass(frozen=True)
class KalibrModel:
    """The matrices of Kalibr's models, in its frame i.

    Attributes
    ----------
    M_a, M_w : (3, 3)
        Lower triangular.
    C_gyro_i : (3, 3)
        From i to the gyros' frame.
    A : (3, 3)
        Gyro readings per specific force in the gyros' frame, rad/s per m/s^2.
    arms : (3, 3)
        Rows rx_i, ry_i, rz_i, m; rx_i is zero.
    bias_w, bias_a : (3,)
        What is added last. Kalibr's files do not hold it.
    """

    M_a: Array
    M_w: Array
    C_gyro_i: Array
    A: Array
    arms: Array
    bias_w: Array
    bias_a: Array


def lower_triangular(S: Array) -> tuple[Array, Array]:
    """Return a lower triangular matrix with a positive diagonal and an orthogonal one (3, 3) whose product is S."""
    Q, R = np.linalg.qr(S.T)
    signs = np.where(np.diag(R) < 0.0, -1.0, 1.0)
    return np.tril((R * signs[:, None]).T), (Q * signs).T


def inverse(matrix: Array) -> Array:
    """Return the inverse of a matrix (3, 3)."""
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def kalibr_model(p: SensorParameters) -> tuple[KalibrModel, Array, Array]:
    """Return the model of parameters, the rotation C_ib (3, 3) into i from their frame, and the origin of i in it, m.

    Notes
    -----
    Gyro readings that respond to raw accelerations, w' + G a', respond to the specific force by -G K_a^-1, and their
    bias contains G k_a0.
    """
    M_a, C_ib = lower_triangular(inverse(p.K_a))
    if np.linalg.det(C_ib) < 0.0:  # a left-handed triad: its last axis counts downward
        M_a, C_ib = M_a * [1.0, 1.0, -1.0], C_ib * [[1.0], [1.0], [-1.0]]
    origin = p.lever_arms[0]
    q = turned(p, C_ib.T, origin)
    M_w, C_gyro_i = lower_triangular(inverse(q.K_omega))
    if np.linalg.det(C_gyro_i) < 0.0:
        M_w, C_gyro_i = M_w * [1.0, 1.0, -1.0], C_gyro_i * [[1.0], [1.0], [-1.0]]
    G = np.asarray(p.others.get("gyro_g_sensitivity", np.zeros(9)), dtype=float).reshape(3, 3)
    A = -G @ M_a @ C_gyro_i.T
    model = KalibrModel(M_a, M_w, C_gyro_i, A, q.lever_arms, -p.k_w[0] + G @ p.k_a[0], -p.k_a[0])
    return model, C_ib, origin


@dataclass(frozen=True)
class InKalibrsFrame:
    """Parameters as Kalibr sees them.

    Attributes
    ----------
    model, sensors
        In frame i: its model, and all of the parameters.
    held
        What the formats hold of these: no biases, of the effects the sensitivity to acceleration alone.
    C_ib, origin
        From the former frame to i, and where its origin was, m.
    """

    model: KalibrModel
    sensors: SensorParameters
    held: SensorParameters
    C_ib: Array
    origin: Array


def in_kalibrs_frame(p: SensorParameters) -> InKalibrsFrame:
    """Return parameters in Kalibr's frame i, with its model of them."""
    model, C_ib, origin = kalibr_model(p)
    sensors = turned(p, C_ib.T, origin)
    return InKalibrsFrame(model, sensors, held_by_kalibr(sensors), C_ib, origin)


def held_by_kalibr(p: SensorParameters) -> SensorParameters:
    """Return what Kalibr's files hold of parameters, in the same axes; see `InKalibrsFrame.held`."""
    sensitivity = {group: value for group, value in p.others.items() if group == "gyro_g_sensitivity"}
    still = np.zeros((1, 3))
    return replace(without_effects_of(p), k_w=still, k_a=still, others=sensitivity)


def uncoupled(model: KalibrModel) -> float:
    """Return the largest error of Kalibr's size effect, m: times the square of a rate, or an angular acceleration.

    Its positions act on components in i, not along sensitive axes.
    """
    error = 0.0
    for j in range(3):
        for k in range(j):
            error += abs(model.M_a[j, k]) * float(np.linalg.norm(model.arms[j] - model.arms[k]))
    return error


def parameters_of(model: KalibrModel) -> SensorParameters:
    """Return the parameters of a model, in its frame i."""
    G = -model.A @ model.C_gyro_i @ inverse(model.M_a)
    return SensorParameters(
        K_omega=inverse(model.M_w @ model.C_gyro_i),
        k_w=-(model.bias_w - G @ -model.bias_a)[None],
        K_a=inverse(model.M_a),
        k_a=-model.bias_a[None],
        lever_arms=model.arms,
        others={"gyro_g_sensitivity": G.ravel()} if np.any(G) else {},
    )


def imu_table(path: Path) -> dict[str, Any]:
    """Return the first IMU's table in a YAML file of Kalibr or OpenVINS.

    Raises
    ------
    RecordingError
        If there is none.
    """
    try:
        lines = read_text(path, MAX_YAML).splitlines()
        text = "\n".join(line for line in lines if not line.startswith("%"))
        content = YAML(typ="safe").load(text)
        check_entries(content)
    except (OSError, ValueError, YAMLError, RecursionError) as error:
        raise RecordingError(f"not a YAML file that can be read: {str(error).splitlines()[0]}", file=path) from error
    if isinstance(content, dict) and isinstance(content.get("imu0"), dict):
        content = content["imu0"]
    if not isinstance(content, dict) or not {"model", "gyroscope_noise_density", "Tw"} & set(content):
        raise RecordingError("holds no IMU: expected imu0 with model, gyroscopes and accelerometers", file=path)
    return content


def rotation_of(rows: Any) -> Array:
    """Return rows of numbers as a rotation matrix (3, 3).

    Raises
    ------
    ValueError
        If they are something else.
    """
    out = matrix_of(rows)
    if np.abs(out @ out.T - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(out) < 0.0:
        raise ValueError(f"{str(rows)[:60]} is not a rotation")
    return out


def triangle_of(rows: Any) -> Array:
    """Return rows of numbers as a lower triangular matrix (3, 3).

    Raises
    ------
    ValueError
        If they are something else.
    """
    out = matrix_of(rows)
    if np.any(np.triu(out, 1)):
        raise ValueError(f"{str(rows)[:60]} is not lower triangular")
    return out


def matrix_of(rows: Any) -> Array:
    """Return rows of numbers as a matrix (3, 3).

    Raises
    ------
    ValueError
        If they are something else.
    """
    if "True" in str(rows) or "False" in str(rows):
        raise ValueError(f"{str(rows)[:60]} holds what is no number")
    out = np.array(rows, dtype=float)
    if out.shape != (3, 3) or not np.isfinite(out).all():
        raise ValueError(f"got {str(rows)[:60]}, expected three rows of three numbers")
    return out

"""Formats that hold numbers and leave the formula to their reader: imu_tk, imu_calib of ROS, and JSON."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from kreisel.errors import SettingsError
from kreisel.exchange.exported import Exported, ExportRequest
from kreisel.exchange.losses import losses, without_effects_of
from kreisel.geometry.rotation import Array


def export_imu_tk(request: ExportRequest) -> Exported:
    """Return the two files of imu_tk: misalignment T, scale K and bias B of X' = T K (X - B), for each sensor.

    Raises
    ------
    SettingsError
        In axes in which the accelerometers' T is not upper triangular.

    Notes
    -----
    Tedaldi, Pretto, Menegatti (2014); calibration.h of imu_tk. T has ones on its diagonal.
    """
    full = request.calibration.sensors
    if np.any(np.tril(full.K_a, -1)):
        raise SettingsError("imu_tk's axes are those of its accelerometers, with an upper triangular T; use --axes imu")
    held = replace(without_effects_of(full), lever_arms=np.zeros((3, 3)))
    files = {}
    for name, K, k_0 in (("_acc", full.K_a, full.k_a[0]), ("_gyro", full.K_omega, full.k_w[0])):
        scale = np.diag(K)
        files[name] = "\n\n".join(_block(part) for part in (K / scale, np.diag(scale), -k_0[:, None])) + "\n\n"
    return Exported(files, held, losses(full, held))


def _block(matrix: Array) -> str:
    return "\n".join(" ".join(repr(float(x)) for x in row) for row in matrix)


def export_ros(request: ExportRequest) -> Exported:
    """Return the file of ROS' imu_calib: corrected = SM raw - bias, for the accelerometers.

    Notes
    -----
    accel_calib.cpp of dpkoch/imu_calib; its node finds the gyros' offsets itself when it starts.
    """
    full = request.calibration.sensors
    held = replace(without_effects_of(full), K_omega=np.eye(3), k_w=np.zeros((1, 3)), lever_arms=np.zeros((3, 3)))
    lost = losses(full, held)
    bias = -full.K_a @ full.k_a[0]
    notes = (
        "imu_calib corrects accelerometers: corrected = SM raw - bias. It finds the gyros' offsets when it starts.",
        "For all of it, `kreisel apply` writes corrected bags; sensor_msgs/Imu has +g upward at rest, as here.",
    )
    lines = [f"# {text}" for text in (*request.caveats, *notes, *(f"Not held: {text}" for text in lost))]
    lines += ["SM:", *(f"  - {float(x)!r}" for x in full.K_a.ravel()), "bias:", *(f"  - {float(x)!r}" for x in bias)]
    return Exported({"": "\n".join(lines) + "\n"}, held, lost, notes)


def export_json(request: ExportRequest) -> Exported:
    """Return the whole result file as JSON, in the axes chosen; nothing is lost."""
    calibration = request.calibration
    return Exported({"": json.dumps(calibration.document, indent=1) + "\n"}, calibration.sensors)

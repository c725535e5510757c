"""OpenVINS' kalibr_imu_chain.yaml: written, and read.

It corrects readings by the inverses of Tw and Ta, with Kalibr's directions, in the frame i of Kalibr:

    a = R_IMUtoACC^T Ta^-1 (a' - b_a),    w = R_IMUtoGYRO^T Tw^-1 (w' - b_g - Tg a)

Source: Propagator.cpp and VioManagerOptions.h of rpng/open_vins. Tg multiplies the specific force in i, so that it is
A C_gyro_i of Kalibr; the comments in its configuration files say A.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.calibration.result import Calibration
from kreisel.errors import RecordingError
from kreisel.exchange.exported import Exported, ExportRequest
from kreisel.exchange.imported import imported
from kreisel.exchange.kalibr_model import (
    KalibrModel,
    imu_table,
    in_kalibrs_frame,
    inverse,
    matrix_of,
    parameters_of,
    rotation_of,
)
from kreisel.exchange.losses import losses


def export(request: ExportRequest) -> Exported:
    """Return OpenVINS' IMU chain of a calibration.

    Raises
    ------
    SettingsError
        If noise figures are missing.
    """
    calibration, noise = request.calibration, request.noise.complete()
    own = in_kalibrs_frame(calibration.sensors)
    model, held = own.model, replace(own.held, lever_arms=np.zeros((3, 3)))
    lost = losses(own.sensors, held)
    matrices = {
        "Tw": model.M_w,
        "R_IMUtoGYRO": model.C_gyro_i,
        "Ta": model.M_a,
        "R_IMUtoACC": np.eye(3),
        "Tg": model.A @ model.C_gyro_i,
    }
    figures = noise.figures
    lines = [
        "%YAML:1.0",
        "",
        *(f"# {line}" for line in _comments(request, model, lost)),
        "imu0:",
        "  T_i_b:",
        *(f"    - [{', '.join(f'{x:.1f}' for x in row)}]" for row in np.eye(4)),
        f"  accelerometer_noise_density: {figures['accel_density']:.9g}",
        f"  accelerometer_random_walk: {figures['accel_walk']:.9g}",
        f"  gyroscope_noise_density: {figures['gyro_density']:.9g}",
        f"  gyroscope_random_walk: {figures['gyro_walk']:.9g}",
        f"  rostopic: {json.dumps(request.topic)}",
        "  time_offset: 0.0",
        f"  update_rate: {request.rate_hz or 0.0:.6g}",
        '  model: "kalibr"',
    ]
    for name, matrix in matrices.items():
        lines += [f"  {name}:", *(f"    - [{', '.join(repr(float(x)) for x in row)}]" for row in matrix)]
    return Exported({"": "\n".join(lines) + "\n"}, held, lost)


def _comments(request: ExportRequest, model: KalibrModel, lost: tuple[str, ...]) -> list[str]:
    biases = [", ".join(f"{x:.9g}" for x in bias) for bias in (model.bias_w, model.bias_a)]
    return [
        "By kreisel. Tw, Ta: true to measured. Frame i: x along the sensitive axis of accelerometer x, y in the plane",
        "of those of x and y; origin at accelerometer x. Tg multiplies the specific force in i.",
        f"Biases, which OpenVINS estimates itself: gyroscope [{biases[0]}] rad/s, accelerometer [{biases[1]}] m/s^2.",
        *request.caveats,
        *(f"{name}: {source}" for name, source in request.noise.sources.items()),
        *(f"Not held: {text}" for text in lost),
    ]


def read(path: Path) -> Calibration:
    """Return the calibration in OpenVINS' IMU chain, in the axes of its IMU.

    Raises
    ------
    RecordingError
        If it is no such file, or lacks a matrix.
    """
    table = imu_table(path)
    try:
        Tw, Ta, Tg = (matrix_of(table[name]) for name in ("Tw", "Ta", "Tg"))
        R_w, R_a = (rotation_of(table[name]) for name in ("R_IMUtoGYRO", "R_IMUtoACC"))
        # a = R_a^T Ta^-1 a': the general form of K_a; Tg acts on the result
        G = -Tg @ R_a.T @ inverse(Ta)
        still = np.zeros((1, 3))
        sensors = replace(
            parameters_of(KalibrModel(Ta, Tw, R_w, np.zeros((3, 3)), np.zeros((3, 3)), still[0], still[0])),
            K_a=R_a.T @ inverse(Ta),
            others={"gyro_g_sensitivity": G.ravel()} if np.any(G) else {},
        )
        return imported(path, sensors, float(table.get("update_rate") or 0.0), "OpenVINS; without biases")
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise RecordingError(f"not a configuration of OpenVINS with intrinsics: {error}", file=path) from error

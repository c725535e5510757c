"""Kalibr's imu.yaml: written, and read. The model is in `kalibr_model`."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from kreisel.calibration.result import Calibration, represent_number
from kreisel.errors import RecordingError
from kreisel.exchange.exported import Exported, ExportRequest
from kreisel.exchange.imported import imported
from kreisel.exchange.kalibr_model import (
    InKalibrsFrame,
    KalibrModel,
    imu_table,
    in_kalibrs_frame,
    matrix_of,
    parameters_of,
    rotation_of,
    triangle_of,
    uncoupled,
)
from kreisel.exchange.losses import RATE, losses
from kreisel.geometry.rotation import Array
from kreisel.units import MG

MODELS = ("calibrated", "scale-misalignment", "scale-misalignment-size-effect")

FORMULA = (
    "a = M C_i_b f + b, w = M C_gyro_i C_i_b omega + A C_gyro_i C_i_b f + b, with these biases b, which the format"
)
FRAME_I = (
    "Frame i: x along the sensitive axis of accelerometer x, y in the plane of those of x and y; origin at",
    "accelerometer x.",
)


def export(request: ExportRequest) -> Exported:
    """Return Kalibr's imu.yaml of a calibration, as Kalibr writes it.

    Raises
    ------
    SettingsError
        If noise figures are missing.
    """
    calibration = request.calibration
    own = in_kalibrs_frame(calibration.sensors)
    T_i_b, time_offset = np.eye(4), 0.0
    if calibration.axes == "tool":
        T_i_b[:3, :3], T_i_b[:3, 3] = own.C_ib, -own.C_ib @ own.origin
        time_offset = -calibration.timing.offset
    lost = losses_of(own)
    head = _comments(request, own.model, lost)
    return Exported({"": head + dumped({"imu0": imu_entry(request, own.model, T_i_b, time_offset)})}, own.held, lost)


def imu_entry(request: ExportRequest, model: KalibrModel, T_i_b: Array, time_offset: float) -> dict[str, Any]:
    """Return what Kalibr writes of an IMU.

    Parameters
    ----------
    T_i_b : (4, 4)
        p_i = T_i_b p_b.
    time_offset
        s, added to stamps of this IMU.

    Raises
    ------
    SettingsError
        If noise figures are missing.
    """
    figures = request.noise.complete().figures
    return {
        "T_i_b": T_i_b.tolist(),
        "accelerometer_noise_density": figures["accel_density"],
        "accelerometer_random_walk": figures["accel_walk"],
        "accelerometers": {
            "M": model.M_a.tolist(),
            **{f"r{axis}_i": row for axis, row in zip("xyz", model.arms.tolist(), strict=True)},
        },
        "gyroscope_noise_density": figures["gyro_density"],
        "gyroscope_random_walk": figures["gyro_walk"],
        "gyroscopes": {"A": model.A.tolist(), "C_gyro_i": model.C_gyro_i.tolist(), "M": model.M_w.tolist()},
        "model": MODELS[2],
        "rostopic": request.topic,
        "time_offset": time_offset,
        "update_rate": request.rate_hz,
    }


def losses_of(own: InKalibrsFrame) -> tuple[str, ...]:
    """Return what Kalibr's files do not hold of parameters, with what its size effect leaves out."""
    lost = losses(own.sensors, own.held)
    error = uncoupled(own.model) * RATE**2
    if error < 1e-3 * MG:
        return lost
    return (*lost, f"the size effect along axes that are not orthogonal: {error / MG:.2g} mg at 100 deg/s")


def bias_text(model: KalibrModel) -> str:
    """Return the biases, which the format does not hold."""
    gyro, accel = (", ".join(f"{x:.9g}" for x in bias) for bias in (model.bias_w, model.bias_a))
    return f"gyroscope [{gyro}] rad/s, accelerometer [{accel}] m/s^2"


def _comments(request: ExportRequest, model: KalibrModel, lost: tuple[str, ...]) -> str:
    calibration = request.calibration
    frames = (
        [
            "T_i_b: from b, the body whose pose the reference gave, to i: p_i = T_i_b p_b. (Kalibr's own b is imu0.)",
            "time_offset: t_reference = t_imu + time_offset, as Kalibr's t_imu0 = t_imu1 + time_offset. Kalibr's",
            "timeshift_cam_imu has the other sign: t_imu = t_cam + shift.",
        ]
        if calibration.axes == "tool"
        else [
            "T_i_b: identity, because this is imu0, to which Kalibr's b belongs. time_offset: 0 for the same reason.",
            *FRAME_I,
        ]
    )
    title = "IMU" if calibration.recording is None else calibration.recording.title
    lines = [
        f"{title}, by kreisel, as Kalibr writes its results. Direction: true to measured.",
        FORMULA,
        f"does not hold: {bias_text(model)}.",
        *frames,
        *request.caveats,
        *(f"{name}: {source}" for name, source in request.noise.sources.items()),
        *(f"Not held: {text}" for text in lost),
    ]
    return "".join(f"# {line}\n" for line in lines)


def dumped(document: dict[str, Any]) -> str:
    """Return a document as YAML, lists of numbers on one line."""
    yaml, stream = YAML(), StringIO()
    yaml.default_flow_style = None
    yaml.width = 4096
    yaml.representer.add_representer(float, represent_number)
    yaml.dump(document, stream)
    return stream.getvalue()


def read(path: Path) -> Calibration:
    """Return the calibration in Kalibr's imu.yaml, in the axes and with the origin of its frame i.

    Raises
    ------
    RecordingError
        If it is no such file, or holds no matrices.
    """
    table = imu_table(path)
    name = table.get("model")
    if name not in MODELS[1:]:
        raise RecordingError(
            f"model is '{name}', expected {MODELS[1]} or {MODELS[2]}: others hold no calibration", file=path
        )
    try:
        gyro, accel = table["gyroscopes"], table["accelerometers"]
        arms = [accel.get(f"r{axis}_i", [0.0, 0.0, 0.0]) for axis in "xyz"]
        model = KalibrModel(
            M_a=triangle_of(accel["M"]),
            M_w=triangle_of(gyro["M"]),
            C_gyro_i=rotation_of(gyro["C_gyro_i"]),
            A=matrix_of(gyro["A"]),
            arms=matrix_of(arms),
            bias_w=np.zeros(3),
            bias_a=np.zeros(3),
        )
        return imported(path, parameters_of(model), float(table.get("update_rate") or 0.0), "Kalibr; without biases")
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise RecordingError(f"not a result of Kalibr: {error}", file=path) from error

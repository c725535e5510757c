"""The result folder of a tray of three units, written without a calibration of one."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.array.array_file import FILE, SCHEMA
from kreisel.array.relative_pose import RelativePose, pose_derivatives
from kreisel.calibration.result import Calibration, write_document
from kreisel.calibration.result_sections import Verdict
from kreisel.inertial.sensor_model import SensorParameters

from ..calibration.example import calibration

CLOCK = {"offset": -1.5, "offset_sd": 1.5e-5, "skew": 2.0e-5, "skew_sd": 1e-7}
MOUNTS = ((0.05, -0.1, 1.5), (2.9, 0.3, -0.4), (0.2, 1.3, 0.1))


def units() -> dict[str, Calibration]:
    """Return three devices on one body, turned and placed differently, two of them sensitive to g."""
    out = {}
    for k, mount in enumerate(MOUNTS):
        own = calibration(mount, seed=3 + k)
        G = np.random.default_rng(k).normal(0.0, 2e-5, 9)
        place = [0.1 * k, -0.05 * k, 0.02]
        sensors = replace(own.sensors, lever_arms=own.sensors.lever_arms + place, others={"gyro_g_sensitivity": G})
        out[f"imu{k}"] = replace(own, sensors=sensors)
    return out


def rejected(one: Calibration, reason: str) -> Calibration:
    return replace(one, verdict=Verdict(False, (reason,)))


def placed(base: SensorParameters, own: SensorParameters) -> dict[str, object]:
    """Return what `array.yaml` says of a unit."""
    position, rotation, J = pose_derivatives(base, own)
    return {**RelativePose(position, rotation, 1e-8 * J @ J.T).document, "clock": dict(CLOCK)}


def write_tray(folder: Path, tray: dict[str, Calibration], places: dict[str, dict[str, object]] | None = None) -> Path:
    """Write the folder; places: those of the other units, by default the true ones."""
    base, *others = tray
    if places is None:
        places = {name: placed(tray[base].sensors, tray[name].sensors) for name in others}
    for name, one in tray.items():
        one.save(folder / name)
    document = {"schema": SCHEMA, "reference": base, "imus": places, "left_out": {"imu7": "did not turn"}}
    write_document(document, folder / FILE)
    return folder

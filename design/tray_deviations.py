"""Deviations of a unit's parameters against the number of units on its tray.

Run: python design/tray_deviations.py > docs/data/tray-deviations.csv

Two arms: the usual one of a virtual cell, and one that errs by a tenth of it. Medians over units and seeds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.array.tray import calibrate_tray
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.device_axes import vector_of
from kreisel.calibration.result import Calibration
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell, Errors
from kreisel.units import DEG_PER_HOUR, MG, MM, PPM

COUNTS, SEEDS = (1, 2, 4, 8, 16), (1,)
COLUMNS = {
    "gyro matrix (ppm)": (slice(0, 9), PPM), "gyro offset (deg/h)": (slice(9, 12), DEG_PER_HOUR),
    "accelerometer matrix (ppm)": (slice(12, 21), PPM), "accelerometer offset (mg)": (slice(21, 24), MG),
    "lever arms (mm)": (slice(24, 33), MM),
}  # fmt: skip


def main() -> None:
    """Print the table."""
    print("arm,units," + ",".join(COLUMNS))
    for arm, share in (("usual", 1.0), ("a tenth of its errors", 0.1)):
        found: dict[int, list[np.ndarray[Any, Any]]] = {count: [] for count in COUNTS}
        for seed in SEEDS:
            cell = _cell(seed, share)
            made = {f"imu{k}": simulate(cell, Path("tray"), unit=k)[1] for k in range(max(COUNTS))}
            for count in COUNTS:
                print(arm, seed, count, file=sys.stderr, flush=True)
                found[count] += [vector_of(one.sensor_sd) for one in _calibrated(made, count)]
        for count, deviations in found.items():
            if deviations:
                rows = np.array(deviations)
                cells = [f"{np.median(rows[:, part]) / size:.3g}" for part, size in COLUMNS.values()]
                print(f"{arm},{count},{','.join(cells)}", flush=True)


def _cell(seed: int, share: float) -> Cell:
    errors = {
        name: value * share for name, value in Errors().model_dump().items()
        if isinstance(value, float) and name.endswith("_sd")
    }  # fmt: skip
    return Cell.model_validate({
        "seed": seed, "seconds": 100.0, "imu": {"grade": "industrial-mems"}, "errors": errors,
        "tray": {"units": max(COUNTS), "spacing": 0.03, "clock_offset": 1.0, "clock_drift_ppm": 20.0},
    })  # fmt: skip


def _calibrated(made: dict[str, Recording], count: int) -> list[Calibration]:
    if count == 1:
        one = run_calibration(made["imu0"], CalibrationSettings()).calibration
        return [one] if one.accepted else []
    outcome = calibrate_tray(made.__getitem__, list(made)[:count], CalibrationSettings())
    return [unit.calibration for unit in outcome.units if unit.calibration.accepted]


if __name__ == "__main__":
    main()

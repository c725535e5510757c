"""How accurate a calibration becomes, by reference and duration.

Run: python design/accuracy_budget.py -o docs/data/accuracy.csv. The table of docs/explanation/accuracy.md: standard
deviations that a calibration states, as medians over seeds, and the rms of error over standard deviation as a check.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell

REFERENCES: dict[str, dict[str, Any]] = {
    "arm with joint angles": {},
    "arm, poses only": {"reference": {"joints": False}},
    "motion capture": {"reference": {"kind": "mocap"}},
}

SHOWN = {
    "gyro_scale_error_ppm": "gyro scale, ppm",
    "gyro_bias_deg_h": "gyro bias, deg/h",
    "gyro_non_orthogonality_mrad": "gyro non-orth., mrad",
    "accel_scale_error_ppm": "accel. scale, ppm",
    "accel_bias_mg": "accel. bias, mg",
    "accel_non_orthogonality_mrad": "accel. non-orth., mrad",
    "accel_distances_mm": "distances, mm",
}


def main() -> None:
    """Simulate, calibrate, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--durations", type=float, nargs="+", default=[60.0, 180.0, 600.0])
    parser.add_argument("--grades", nargs="+", default=["consumer-mems", "industrial-mems", "fog-mems"])
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    opened = arguments.output.open("w", encoding="utf-8", newline="") if arguments.output else nullcontext(sys.stdout)
    with opened as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["device", "reference", "duration, s", *SHOWN.values(), "error / sd"])
        for grade in arguments.grades:
            for name, changes in REFERENCES.items():
                for seconds in arguments.durations:
                    row = median_of(grade, changes, seconds, arguments.seeds)
                    table.writerow([grade, name, f"{seconds:.0f}", *row])
                    stream.flush()


def median_of(grade: str, changes: dict[str, Any], seconds: float, seeds: int) -> list[str]:
    """Return the median deviations over seeds as texts, and the rms of error over deviation of all figures."""
    deviations, scores = [], []
    for seed in range(seeds):
        cell = Cell.model_validate({"seed": 700 + seed, "seconds": seconds, "imu": {"grade": grade}, **changes})
        with tempfile.TemporaryDirectory() as folder:
            truth, recording = simulate(cell, Path(folder))
            found = run_calibration(recording, CalibrationSettings()).calibration
        if not found.accepted:
            continue
        deviations.append([float(np.median(found.derived[name].deviation)) for name in SHOWN])
        for quantity in QUANTITIES:
            if quantity.name in SHOWN:
                own = found.derived[quantity.name]
                scores += ((own.value - quantity.value(truth.sensors)) / own.deviation).tolist()
    if not deviations:
        return ["rejected"] * (len(SHOWN) + 1)
    shown = [f"{float(f'{value:.2g}'):g}" for value in np.median(deviations, axis=0)]
    return [*shown, f"{np.sqrt(np.mean(np.square(scores))):.2f}"]


if __name__ == "__main__":
    main()

"""How accurate a calibration becomes, by reference and duration: ``python design/accuracy_budget.py``.

Prints the table of docs/explanation/accuracy.md: standard deviations that a calibration states, as medians over seeds,
and the rms of error over standard deviation as a check of them.
"""

from __future__ import annotations

import argparse
import tempfile
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

SHOWN = ("gyro_scale_error_ppm", "gyro_bias_deg_h", "gyro_non_orthogonality_mrad", "accel_scale_error_ppm",
         "accel_bias_mg", "accel_non_orthogonality_mrad", "accel_distances_mm")  # fmt: skip


def main() -> None:
    """Simulate, calibrate, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--durations", type=float, nargs="+", default=[60.0, 180.0, 600.0])
    parser.add_argument("--grades", nargs="+", default=["consumer-mems", "industrial-mems", "fog-mems"])
    arguments = parser.parse_args()
    units = {quantity.name: quantity.unit for quantity in QUANTITIES}
    print("| device | reference | s | " + " | ".join(f"{name} ({units[name]})" for name in SHOWN) + " | error / sd |")
    print("|---" * (len(SHOWN) + 4) + "|")
    for grade in arguments.grades:
        for name, changes in REFERENCES.items():
            for seconds in arguments.durations:
                row = median_of(grade, changes, seconds, arguments.seeds)
                print(f"| {grade} | {name} | {seconds:.0f} | " + " | ".join(row) + " |", flush=True)


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
    shown = [f"{value:.2g}" for value in np.median(deviations, axis=0)]
    return [*shown, f"{np.sqrt(np.mean(np.square(scores))):.2f}"]


if __name__ == "__main__":
    main()

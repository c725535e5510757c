"""Trials of the static calibration by robot, beside the dynamic one on the same recordings.

python design/static_by_robot.py [--trials N] [--first K] [--dynamic M] [-o docs/data/static-by-robot.csv]

The first M trials of each cell are calibrated dynamically too.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.calibration.result import Calibration
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array
from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.static.by_robot import calibrate_by_robot
from kreisel.study.robustness import WRONG
from kreisel.validation.checks import check_streams

SECONDS = 200.0
SHOWN = ("gyro_scale_error_ppm", "accel_scale_error_ppm", "accel_bias_mg", "gyro_to_accel_rotation_mrad")
HEADER = ["cell", "method", "runs", "accepted", "wrong", "worst accepted", "error / sd", "gyro scale, ppm",
          "accelerometer scale, ppm", "accelerometer bias, mg", "between sensors, mrad", "lever arms, mm"]  # fmt: skip
COUNTED = tuple(q for q in QUANTITIES if q.name not in ("mounting_rotation_deg", "accel_distances_mm"))
"""What does not depend on the tool frame, which an arm's last link and the mounting share."""


def measured(calibration: Calibration, true: SensorParameters) -> tuple[Array, list[float]]:
    """Return scores of what both methods estimate, and rms deviations of the columns of the table."""
    found = calibration.derived
    scores = [(found[q.name].value - q.value(true)) / found[q.name].deviation for q in COUNTED]
    sizes = [found[name].deviation for name in SHOWN] + [calibration.sensor_sd.lever_arms.ravel() * 1e3]
    return np.concatenate(scores), [float(np.sqrt(np.mean(part**2))) for part in sizes]


def row(cell: str, method: str, found: list[tuple[Calibration, SensorParameters]], runs: int) -> list[str]:
    """Return the row of a cell and a method."""
    accepted = [measured(*one) for one in found if one[0].accepted]
    if not accepted:
        return [cell, method, str(runs), "0", "0", *[""] * 7]
    worst = [float(np.abs(scores).max()) for scores, _ in accepted]
    ratio = np.sqrt(np.mean(np.concatenate([scores for scores, _ in accepted]) ** 2))
    sizes = np.median([size for _, size in accepted], axis=0)
    arms = f"{sizes[4]:.2g}" if method == "dynamic" else "not shown"
    return [cell, method, str(runs), str(len(accepted)), str(sum(w > WRONG for w in worst)), f"{max(worst):.1f}",
            f"{ratio:.2f}", *(f"{s:.2g}" for s in sizes[:4]), arms]  # fmt: skip


def main() -> None:
    """Run the trials, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--dynamic", type=int, default=0)
    parser.add_argument("--grades", nargs="+", choices=list(GRADES))
    parser.add_argument("-o", type=Path)
    args = parser.parse_args()
    table = [HEADER]
    for grade in args.grades or GRADES:
        for joints in (True, False):
            name = f"{grade}, {'joint angles' if joints else 'poses alone'}"
            still, moved = [], []
            for k in range(args.trials):
                content = {"seed": args.first + k, "seconds": SECONDS, "reference": {"joints": joints},
                           "imu": {"grade": grade}}  # fmt: skip
                truth, recording = simulate(Cell.model_validate(content), Path("cell"))
                try:
                    still.append(
                        (calibrate_by_robot(check_streams(recording), CalibrationSettings()).calibration, truth.sensors)
                    )
                    if k < args.dynamic:
                        moved.append((run_calibration(recording, CalibrationSettings()).calibration, truth.sensors))
                except KreiselError as error:
                    print(name, k, error)
            table.append(row(name, "static", still, args.trials))
            print("  ".join(table[-1]), flush=True)
            if args.dynamic:
                table.append(row(name, "dynamic", moved, args.dynamic))
                print("  ".join(table[-1]), flush=True)
    if args.o is not None:
        with args.o.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()

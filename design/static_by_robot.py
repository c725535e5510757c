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
HEADER = ["cell", "method", "runs", "accepted", "wrong", "worst accepted", "K: error / sd", "offsets: error / sd",
          "gyro matrix, ppm", "accelerometer matrix, ppm", "accelerometer offset, mg", "lever arms, mm"]  # fmt: skip


def measured(calibration: Calibration, true: SensorParameters) -> tuple[list[Array], list[float]]:
    """Return scores of K and of offsets, and rms deviations of the columns of the table."""
    p, sd = calibration.sensors, calibration.sensor_sd
    scores = [
        np.concatenate([((p.K_omega - true.K_omega) / sd.K_omega).ravel(), ((p.K_a - true.K_a) / sd.K_a).ravel()]),
        np.concatenate([(p.k_w[0] - true.k_w[0]) / sd.k_w[0], (p.k_a[0] - true.k_a[0]) / sd.k_a[0]]),
    ]
    sizes = (sd.K_omega * 1e6, sd.K_a * 1e6, sd.k_a[0] / 9.80665e-3, sd.lever_arms * 1e3)
    return scores, [float(np.sqrt(np.mean(part**2))) for part in sizes]


def row(cell: str, method: str, found: list[tuple[Calibration, SensorParameters]], runs: int) -> list[str]:
    """Return the row of a cell and a method."""
    accepted = [measured(*one) for one in found if one[0].accepted]
    if not accepted:
        return [cell, method, str(runs), "0", "0", *[""] * 7]
    worst = [max(np.abs(part).max() for part in scores) for scores, _ in accepted]
    ratios = [np.sqrt(np.mean(np.concatenate([s[k] for s, _ in accepted]) ** 2)) for k in (0, 1)]
    sizes = np.median([size for _, size in accepted], axis=0)
    arms = f"{sizes[3]:.2g}" if method == "dynamic" else ""
    return [cell, method, str(runs), str(len(accepted)), str(sum(w > WRONG for w in worst)), f"{max(worst):.1f}",
            *(f"{r:.2f}" for r in ratios), *(f"{s:.2g}" for s in sizes[:3]), arms]  # fmt: skip


def main() -> None:
    """Run the trials, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--dynamic", type=int, default=0)
    parser.add_argument("-o", type=Path)
    args = parser.parse_args()
    table = [HEADER]
    for grade in GRADES:
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

"""What each error of a robot alone does to a calibration: rms errors over a few trials, ten minutes each.

Run: python design/error_budget.py fog-mems 4 600 -o docs/data/arm_errors.csv. The arm is otherwise nearly perfect
(0.02 mm, 0.02 mrad).
"""

import argparse
import csv
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell_settings import Cell
from kreisel.study.monte_carlo import run_trial
from kreisel.study.trial import Trial
from kreisel.units import MG, MM, PPM

NEARLY_PERFECT = {
    "geometry_length_sd": 0.0, "geometry_angle_sd": 0.0,
    "repeatability_position_sd": 2e-5, "repeatability_orientation_sd": 2e-5,
    "path_position_sd": 2e-5, "path_orientation_sd": 2e-5, "path_correlation_time": 0.0,
}  # fmt: skip
CASES = {
    "none": {},
    "geometry, 0.3 mm and 0.3 mrad a joint": {"geometry_length_sd": 3e-4, "geometry_angle_sd": 3e-4},
    "eccentric gears, 0.1 mrad": {"gear_eccentricity_sd": 1e-4},
    "sag, 0.3 mrad": {"sag_sd": 3e-4},
    "repeatability, 0.1 mm and 0.1 mrad": {"repeatability_position_sd": 1e-4, "repeatability_orientation_sd": 1e-4},
    "path, 1.5 mm and 1 mrad for 0.15 s": {
        "path_position_sd": 1.5e-3, "path_orientation_sd": 1e-3, "path_correlation_time": 0.15,
    },
    "servo lag of 10 ms, uneven": {"servo_lag": 0.01},
    "8 Hz swing after stops": {"oscillation_frequency": 8.0},
    "encoder steps, 0.1 mrad": {"encoder_step": 1e-4},
}  # fmt: skip
GROUPS = {
    "accel. offset, mg": ("accelerometer.offset", 1 / MG),
    "K of the gyros, ppm": ("gyroscope.cross", 1 / PPM),
    "K of the accelerometers, ppm": ("accelerometer.cross", 1 / PPM),
    "lever arms, mm": ("accelerometer.lever", 1 / MM),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("grade", nargs="?", default="fog")
    parser.add_argument("trials", nargs="?", type=int, default=4)
    parser.add_argument("seconds", nargs="?", type=float, default=600.0)
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    opened = arguments.output.open("w", encoding="utf-8", newline="") if arguments.output else nullcontext(sys.stdout)
    with opened as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["error of the arm", *(f"{title} (error / sd)" for title in GROUPS), "accepted"])
        for name, errors in CASES.items():
            content = {"seed": 20, "seconds": arguments.seconds, "imu": {"grade": arguments.grade}}
            cell = Cell.model_validate(content | {"errors": {**NEARLY_PERFECT, **errors}})
            done = [run_trial(cell, CalibrationSettings(), k) for k in range(arguments.trials)]
            table.writerow([name, *cells(done), f"{sum(t.accepted for t in done)} of {len(done)}"])
            stream.flush()


def cells(done: list[Trial]) -> list[str]:
    """Return rms error and rms of error over standard deviation of each group, as texts."""
    out = []
    for stem, factor in GROUPS.values():
        pairs = [
            (e, s) for t in done for n, e, s in zip(t.names, t.error, t.deviation, strict=True) if n.startswith(stem)
        ]
        e, s = np.array(pairs).T
        rms = factor * np.sqrt(np.mean(e**2))
        out.append(f"{float(f'{rms:.2g}'):g} ({np.sqrt(np.mean((e / s) ** 2)):.1f})")
    return out


if __name__ == "__main__":
    main()

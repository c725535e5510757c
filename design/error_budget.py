"""What each error of a robot alone does to a calibration: rms errors over a few trials, ten minutes each.

Run: python design/error_budget.py [GRADE [TRIALS [SECONDS]]]. The arm is otherwise nearly perfect (0.02 mm, 0.02 mrad).
"""

import sys

import numpy as np

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.simulation.cell_settings import Cell
from kreisel.study.monte_carlo import run_trial

NEARLY_PERFECT = {
    "geometry_length_sd": 0.0, "geometry_angle_sd": 0.0,
    "repeatability_position_sd": 2e-5, "repeatability_orientation_sd": 2e-5,
    "path_position_sd": 2e-5, "path_orientation_sd": 2e-5, "path_correlation_time": 0.0,
}  # fmt: skip
CASES = {
    "nothing": {},
    "geometry 0.3 mm, 0.3 mrad": {"geometry_length_sd": 3e-4, "geometry_angle_sd": 3e-4},
    "gear eccentricity 0.1 mrad": {"gear_eccentricity_sd": 1e-4},
    "sag 0.3 mrad": {"sag_sd": 3e-4},
    "repeatability 0.1 mm, 0.1 mrad": {"repeatability_position_sd": 1e-4, "repeatability_orientation_sd": 1e-4},
    "path 1.5 mm, 1 mrad, 0.15 s": {
        "path_position_sd": 1.5e-3, "path_orientation_sd": 1e-3, "path_correlation_time": 0.15,
    },
    "servo lag 10 ms, uneven": {"servo_lag": 0.01},
    "swing 8 Hz after stops": {"oscillation_frequency": 8.0},
    "encoder step 0.1 mrad": {"encoder_step": 1e-4},
}  # fmt: skip
GROUPS = (("accelerometer.offset", 1 / 9.80665e-3), ("gyroscope.cross", 1e6), ("accelerometer.cross", 1e6),
          ("accelerometer.lever", 1e3))  # fmt: skip


def main(grade: str = "fog", trials: str = "4", seconds: str = "600") -> None:
    print(f"{grade}: rms error (error over standard deviation)")
    print(f"{'error':34s} {'k_a0 mg':>16s} {'K_omega ppm':>16s} {'K_a ppm':>16s} {'lever mm':>16s}  verdicts")
    for name, errors in CASES.items():
        content = {"seed": 20, "seconds": float(seconds), "imu": {"grade": grade}}
        cell = Cell.model_validate(content | {"errors": {**NEARLY_PERFECT, **errors}})
        done = [run_trial(cell, CalibrationSettings(), k) for k in range(int(trials))]
        cells = []
        for stem, factor in GROUPS:
            pairs = [
                (e, s)
                for t in done
                for n, e, s in zip(t.names, t.error, t.deviation, strict=True)
                if n.startswith(stem)
            ]
            e, s = np.array(pairs).T
            cells.append(f"{factor * np.sqrt(np.mean(e**2)):.3g} ({np.sqrt(np.mean((e / s) ** 2)):.1f})")
        print(
            f"{name:34s} " + " ".join(f"{c:>16s}" for c in cells),
            f" {sum(t.accepted for t in done)}/{len(done)}",
            flush=True,
        )


if __name__ == "__main__":
    main(*sys.argv[1:])

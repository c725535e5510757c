"""Trials of the robot calibrated by an IMU: errors against truth, and poses of other motions before and after.

python design/arm_trials.py [--trials N] [--first K] [-o docs/data/arm.csv]
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from kreisel.calibration.arm_calibration import arm_of, arm_of_all
from kreisel.calibration.arm_result import ArmCalibration
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.joint import calibrate_joint
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array, conjugate, log, multiply
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.robot import kinematics
from kreisel.robot.description import Arm
from kreisel.robot.kinematics import load_arm
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import Cell

SECONDS = 200.0
CELLS: dict[str, tuple[int, dict[str, Any]]] = {
    "0.3 mm, 0.3 mrad": (1, {}),
    "1 mm, 1 mrad": (1, {"geometry_length_sd": 1e-3, "geometry_angle_sd": 1e-3}),
    "1 mm, 1 mrad, two recordings": (2, {"geometry_length_sd": 1e-3, "geometry_angle_sd": 1e-3}),
    "0.3 mm, 0.3 mrad, zeros of 2 mrad": (1, {"zero_sd": 2e-3}),
}
HEADER = ["cell", "runs", "accepted", "worst score", "all: error / sd", "shown: error / sd", "shown",
          "mm before", "mm after", "mrad before", "mrad after", "mm after, said", "mrad after, said"]  # fmt: skip


def left(nominal: Arm, actual: Arm, errors: Array, angles: Array) -> list[float]:
    """Return rms position and angle by which an arm with errors misses the actual one, without base and tool frames."""
    corrected = kinematics.with_placement_errors(nominal, errors)
    (p, q), (p_true, q_true) = (kinematics.poses(arm, angles) for arm in (corrected, actual))
    away = np.hstack([p_true - p, log(multiply(conjugate(q), q_true))]).ravel()
    J = kinematics.derivatives(nominal, angles).regressor
    frames = np.concatenate([J[:, :, :6], J[:, :, -6:]], axis=2).reshape(-1, 12)
    away = (away - frames @ np.linalg.lstsq(frames, away, rcond=None)[0]).reshape(-1, 6)
    return [float(np.sqrt(np.mean(np.sum(part**2, axis=1)))) for part in (away[:, :3], away[:, 3:])]


def judged(truth: Truth, nominal: Arm, angles: Array, found: ArmCalibration) -> tuple[list[float], list[float], Array]:
    """Return scores of all errors and of those that are shown, and pose errors before, after and as said."""
    place = {f"robot.placement[{j},{i}]": v for (j, i), v in np.ndenumerate(truth.arm.placement)}
    place |= {f"robot.zeros[{k}]": v for k, v in enumerate(truth.arm.zeros, 1)}
    own = [(e, (e.value - place[e.name]) / e.deviation) for e in found.errors if e.name in place]
    none = np.zeros_like(truth.arm.placement)
    estimate = found.robot.placement.value.copy()
    if found.robot.zeros is not None:  # zeros turn joints about their axes, as errors of placements do
        for k, zero in enumerate(found.robot.zeros.value, 1):
            estimate[k, 3:] += zero * nominal.chain.axes[k]
    actual = truth.actual
    real = truth.arm.placement.copy()
    for k, zero in enumerate(truth.arm.zeros, 1):
        real[k, 3:] += zero * nominal.chain.axes[k]
    actual = kinematics.with_placement_errors(nominal, real)
    before, after = left(nominal, actual, none, angles), left(nominal, actual, estimate, angles)
    said = [found.robot.after.position, found.robot.after.orientation]
    return [s for _, s in own], [s for e, s in own if e.separable], np.array([*before, *after, *said])


def main() -> None:
    """Run the trials, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("-o", type=Path)
    args = parser.parse_args()
    table = [HEADER]
    for name, (count, errors) in CELLS.items():
        everything, shown, poses, accepted = [], [], [], 0
        for k in range(args.first, args.first + args.trials):
            drawn = [
                simulate(
                    Cell.model_validate({"seed": k, "run": run, "seconds": SECONDS, "errors": errors}), Path(f"r{run}")
                )
                for run in range(count + 1)
            ]
            truth, other = drawn[0][0], drawn[-1][1]
            try:
                used = [recording for _, recording in drawn[:-1]]
                found = (
                    arm_of(run_calibration(used[0], CalibrationSettings()))
                    if count == 1
                    else arm_of_all(calibrate_joint(used))
                )
            except KreiselError as error:
                print(name, k, error)
                continue
            if not found.calibration.accepted or other.joints is None:
                continue
            accepted += 1
            with TemporaryDirectory() as folder:
                file = Path(folder) / "nominal.urdf"
                file.write_text(other.urdf or "", encoding="utf-8")
                nominal = load_arm(file, other.settings.robot.tcp)
            own, clear, errors_of_poses = judged(truth, nominal, other.joints.angles[::400], found)
            everything += own
            shown += clear
            poses.append(errors_of_poses)
        p = np.sqrt(np.mean(np.square(poses), axis=0)) * 1e3
        scores = np.array(everything)
        table.append([
            name, str(args.trials), str(accepted), f"{np.abs(scores).max():.1f}",
            f"{np.sqrt(np.mean(scores**2)):.2f}", f"{np.sqrt(np.mean(np.square(shown))):.2f}",
            f"{len(shown) / max(len(everything), 1):.0%}",
            *(f"{v:.2g}" for v in (p[0], p[2], p[1], p[3], p[4], p[5])),
        ])  # fmt: skip
        print("  ".join(table[-1]), flush=True)
    if args.o is not None:
        with args.o.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()

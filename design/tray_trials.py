"""Errors over deviations of units of a tray, over simulated trays: each unit's parameters, and relative poses.

Run: python design/tray_trials.py --trays 50 --first 1 --units 4 [--loose MRAD] [--seconds 100] [--grade NAME] [--alone]

A line for each tray, then the ratios over all of them. With --loose unit 1 turns on its mount by so much in each tray;
with --alone unit 0 is calibrated by itself, too, for comparison.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.array.tray import calibrate_tray
from kreisel.array.tray_outcome import TrayOutcome
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.device_axes import linearised, vector_of
from kreisel.calibration.result import Calibration
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array, from_matrix, log
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import Cell

GROUPS = {
    "gyro matrix": slice(0, 9), "gyro offset": slice(9, 12), "accel matrix": slice(12, 21),
    "accel offset": slice(21, 24), "lever arms": slice(24, 33),
}  # fmt: skip


def main() -> None:
    """Run the trials and print the ratios."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--trays", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--units", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--loose", type=float, default=0.0)
    parser.add_argument("--grade", default="industrial-mems")
    parser.add_argument("--alone", action="store_true")
    given = parser.parse_args()
    squares: dict[str, list[float]] = {}
    deviations: dict[str, list[float]] = {}
    named = accused = used = 0
    for seed in range(given.first, given.first + given.trays):
        cell = _cell(seed, given)
        made = {f"imu{k}": simulate(cell, Path("tray"), unit=k) for k in range(given.units)}
        began = time.perf_counter()
        try:
            outcome = calibrate_tray(partial(_recording_of, made), list(made), CalibrationSettings())
        except KreiselError as error:
            print(f"{seed}: {error}", flush=True)
            continue
        seconds = time.perf_counter() - began
        common = len(outcome.mean.verdict.reasons)
        rejected = [unit.name for unit in outcome.units if len(unit.calibration.verdict.reasons) > common]
        named += "imu1" in rejected
        accused += len([name for name in rejected if not (given.loose and name == "imu1")])
        if outcome.mean.verdict.accepted:
            used += 1
            _add(squares, deviations, outcome, {name: truth.sensors for name, (truth, _) in made.items()}, rejected)
            if given.alone:
                alone = run_calibration(made["imu0"][1], CalibrationSettings()).calibration
                _of_unit(squares, deviations, "alone: ", alone, made["imu0"][0].sensors)
        print(
            f"{seed}: {seconds:.0f} s, mean {outcome.mean.verdict.headline.lower()}"
            f" {'; '.join(outcome.mean.verdict.reasons)}, rejected {rejected}", flush=True
        )  # fmt: skip
    print(f"{used} of {given.trays} used; unit 1 named {named}, others accused {accused}")
    for name, values in squares.items():
        print(f"{name:28s} error/deviation {np.sqrt(np.mean(values)):.2f}, largest {np.sqrt(np.max(values)):.1f}, "
              f"deviation {np.median(deviations[name]):.3g}")  # fmt: skip


def _recording_of(made: dict[str, tuple[Truth, Recording]], name: str) -> Recording:
    return made[name][1]


def _cell(seed: int, given: argparse.Namespace) -> Cell:
    tray: dict[str, Any] = {
        "units": given.units, "clock_offset": 1.0, "clock_drift_ppm": 20.0, "turned_deg": (180.0, 0.0, 0.0),
        "slipping": 1,
    }  # fmt: skip
    imu = {"grade": given.grade, "slip_deg": np.degrees(1e-3 * given.loose)}
    return Cell.model_validate({"seed": seed, "seconds": given.seconds, "imu": imu, "tray": tray})


def _add(
    squares: dict[str, list[float]], deviations: dict[str, list[float]], outcome: TrayOutcome,
    truth: dict[str, SensorParameters], rejected: list[str],
) -> None:  # fmt: skip
    for unit in outcome.units:
        if unit.name not in rejected:
            _of_unit(squares, deviations, "", unit.calibration, truth[unit.name])
    base = linearised(truth[outcome.reference], "imu")
    for name, pose in outcome.poses.items():
        if name in rejected:
            continue
        own = linearised(truth[name], "imu")
        C = base.rotation.T @ own.rotation
        apart = np.concatenate([
            pose.position - base.rotation.T @ (own.origin - base.origin), log(from_matrix(pose.rotation @ C.T))
        ])  # fmt: skip
        sd = np.sqrt(np.diag(pose.covariance))
        for part, rows in (("relative position", slice(0, 3)), ("relative rotation", slice(3, 6))):
            squares.setdefault(part, []).extend((apart[rows] / sd[rows]) ** 2)
            deviations.setdefault(part, []).extend(sd[rows])


def _of_unit(
    squares: dict[str, list[float]], deviations: dict[str, list[float]], prefix: str, found: Calibration,
    truth: SensorParameters,
) -> None:  # fmt: skip
    error: Array = vector_of(found.sensors) - vector_of(truth)
    sd = vector_of(found.sensor_sd)
    for group, rows in GROUPS.items():
        squares.setdefault(prefix + group, []).extend((error[rows] / sd[rows]) ** 2)
        deviations.setdefault(prefix + group, []).extend(sd[rows])


if __name__ == "__main__":
    main()

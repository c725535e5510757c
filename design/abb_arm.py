"""Table of docs/explanation/abb-arm.md: what recordings of one arm say of its joints and of the sensor.

Run: python design/abb_arm.py RECORDING... -o docs/data/abb-arm.csv. The recordings are those of Rasteiro and others
(2015), brought into the layout of recording folders. Each is calibrated as it is, with robot.model = "none", and
with the seconds of the robot stated to be the true ones (imu.time_base = "reference").
"""

from __future__ import annotations

import argparse
import csv
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

import kreisel
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.errors import KreiselError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording
from kreisel.units import MRAD, PPM

HEADER = (
    "run", "verdict", "misfit without (mrad)", "misfit with (mrad)",
    *(f"{name} (mrad)" for joint in ("joints 2 and 3", "joint 4", "joint 5") for name in (joint, f"sd {joint}")),
    *(f"{name} (per mille)" for axis in "xyz" for name in (f"scale {axis}", f"sd scale {axis}")),
    *(f"{name} (per mille)" for axis in "xyz" for name in (f"scale {axis} by robot", f"sd scale {axis} by robot")),
    "clocks (per mille)",
)  # fmt: skip


def main() -> None:
    """Calibrate all recordings, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING")
    parser.add_argument("-o", "--output", type=Path, help="a CSV file; printed if not given")
    arguments = parser.parse_args()
    rows = [row_of(path) for path in arguments.recordings]
    target = nullcontext(sys.stdout) if arguments.output is None else arguments.output.open("w", encoding="utf-8")
    with target as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *rows])


def row_of(path: Path) -> list[str]:
    """Return the row of a recording."""
    recording = kreisel.load(path)
    name = path.name.removeprefix("abb_").replace("_", " ")
    try:
        found = run_calibration(recording, CalibrationSettings())
    except KreiselError as error:
        return [name, f"refused: {str(error).split(': ')[1]}", *[""] * (len(HEADER) - 2)]
    verdict = "accepted" if found.verdict.accepted else f"rejected: {found.verdict.reasons[0].split(':')[0]}"
    without = with_stated(recording, "robot", model="none")
    by_robot = with_stated(recording, "imu", time_base="reference")
    misfit = [f"{_misfit(one):.1f}" for one in (without, found)]
    clocks = f"{1e3 * found.calibration.timing.skew:.2f}"
    scales = _scales(by_robot) if by_robot.verdict.accepted else [""] * 6
    return [name, verdict, *misfit, *_zeros(found), *_scales(found), *scales, clocks]


def with_stated(recording: Recording, table: str, **stated: str) -> Outcome:
    """Return the calibration of a recording with more keys of a table of recording.toml stated."""
    settings = recording.settings
    changed = settings.model_copy(update={table: getattr(settings, table).model_copy(update=stated)})
    return run_calibration(replace(recording, settings=changed), CalibrationSettings())


def _misfit(outcome: Outcome) -> float:
    """Return the noise of orientations on the path that the data ask for, mrad."""
    return float(outcome.problem.noise.reference.orientation / MRAD)


def _zeros(outcome: Outcome) -> list[str]:
    """Return zeros with deviations, of joints 2 and 3 their sum, mrad; nothing where they are not in the model."""
    layout = outcome.problem.layout
    if "robot_zeros" not in layout:
        return [""] * 6
    part, zeros = layout["robot_zeros"], outcome.estimate.run.parameters.robot.zeros
    P = outcome.estimate.belief.covariance[part, part]
    J = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    pairs = zip(J @ zeros, np.sqrt(np.diag(J @ P @ J.T)), strict=True)
    return [f"{value / MRAD:.1f}" for pair in pairs for value in pair]


def _scales(outcome: Outcome) -> list[str]:
    scale = outcome.calibration.derived["gyro_scale_error_ppm"]
    pairs = zip(scale.value, scale.deviation, strict=True)
    return [f"{value * PPM * 1e3:.1f}" for pair in pairs for value in pair]


if __name__ == "__main__":
    main()

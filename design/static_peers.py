"""kreisel static beside imucal (Ferraris) on the same simulated sessions: errors against truth.

python design/static_peers.py [--trials N] [-o docs/data/ferraris.csv]; imucal is a referee of the tests (make test).
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import imucal
import numpy as np

from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.simulation.standstills import GRAVITY, HandTurns, hand_turned
from kreisel.static.known_attitudes import Faces, WholeTurns
from kreisel.static.static_result import StaticOutcome, calibrate_static
from kreisel.validation.checks import check_streams

HEADER = ["device", "program", "gyro scale, ppm", "gyro axes, mrad", "accelerometer scale, ppm",
          "accelerometer axes, mrad", "accelerometer offset, mg", "error / sd"]  # fmt: skip


def by_imucal(found: StaticOutcome) -> SensorParameters:
    """Return imucal's Ferraris calibration of the same standstills and turns, in the axes of the case."""
    imu, rests = found.found.problem.imu, found.found.problem.rests
    faces, turns = found.found.problem.known
    if not isinstance(faces, Faces) or not isinstance(turns, WholeTurns):
        raise SettingsError("expected faces and whole turns")
    degrees = np.degrees(imu.rates)
    regions: dict[str, Array] = {}
    for axis, name in enumerate("xyz"):
        for sign, end in ((1.0, "p"), (-1.0, "a")):
            node = next(n for n, a, s in zip(faces.node, faces.axis, faces.sign, strict=True) if (a, s) == (axis, sign))
            own = slice(rests.first[node], rests.last[node])
            regions |= {f"acc_{name}_{end}": imu.accelerations[own], f"gyr_{name}_{end}": degrees[own]}
        face = {int(n): int(a) for n, a in zip(faces.node, faces.axis, strict=True)}
        node = next(int(n) for n in turns.node if face[int(n)] == axis)
        own = slice(rests.last[node] - 1, rests.first[node + 1])
        regions |= {f"acc_{name}_rot": imu.accelerations[own], f"gyr_{name}_rot": degrees[own]}
    calibration = imucal.FerrarisCalibration(grav=GRAVITY, expected_angle=-360)
    result = calibration.compute(imucal.FerrarisSignalRegions(**regions), 1.0 / imu.interval, "m/s^2", "deg/s")
    K_a, K_g = (np.linalg.inv(R) @ np.linalg.inv(K) for K, R in ((result.K_a, result.R_a), (result.K_g, result.R_g)))
    return SensorParameters(K_g, -np.radians(result.b_g)[None], K_a, -result.b_a[None], np.zeros((3, 3)))


def errors(p: SensorParameters, true: SensorParameters) -> Array:
    """Return rms errors of scale and of axes of both, and of the offsets, whatever the frame."""
    out = []
    for K, K_true in ((p.K_omega, true.K_omega), (p.K_a, true.K_a)):
        G, G_true = (M.T @ M for M in (K, K_true))  # does not depend on the frame
        scale = np.sqrt(np.diag(G)) - np.sqrt(np.diag(G_true))
        pairs = [(0, 1), (0, 2), (1, 2)]
        axes = [
            G[i, j] / np.sqrt(G[i, i] * G[j, j]) - G_true[i, j] / np.sqrt(G_true[i, i] * G_true[j, j]) for i, j in pairs
        ]
        out += [np.sqrt(np.mean(scale**2)) * 1e6, np.sqrt(np.mean(np.square(axes))) * 1e3]
    out.append(np.sqrt(np.mean((p.k_a[0] - true.k_a[0]) ** 2)) / 9.80665e-3)
    return np.array(out)


def session(grade: str, number: int) -> tuple[SensorParameters, StaticOutcome]:
    """Return truth and result of a session as imucal asks for: six faces, and a whole turn on three of them."""
    how = HandTurns(grade, attitudes=6, laid="whole turns", one_sense=True)
    truth, recording = hand_turned(how, np.random.default_rng([number, *grade.encode()]))
    return truth, calibrate_static(check_streams(recording), method="ferraris")


def main() -> None:
    """Run the sessions, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("-o", type=Path)
    args = parser.parse_args()
    table = [HEADER]
    for grade in ("consumer-mems", "industrial-mems", "fog-mems"):
        ours, theirs, scores = [], [], []
        for k in range(args.trials):
            truth, found = session(grade, 301 + k)
            ours.append(errors(found.found.parameters.sensors, truth))
            theirs.append(errors(by_imucal(found), truth))
            sd = found.calibration.derived["accel_scale_error_ppm"].deviation
            true = (np.linalg.norm(np.linalg.inv(truth.K_a), axis=1) - 1.0) * 1e6
            scores += ((found.calibration.derived["accel_scale_error_ppm"].value - true) / sd).tolist()
        for name, rows in (("kreisel", ours), ("imucal", theirs)):
            rms = np.sqrt(np.mean(np.square(rows), axis=0))
            ratio = f"{np.sqrt(np.mean(np.square(scores))):.2f}" if name == "kreisel" else "none stated"
            table.append([grade, name, *(f"{v:.2g}" for v in rms), ratio])
            print("  ".join(table[-1]), flush=True)
    if args.o is not None:
        with args.o.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    main()

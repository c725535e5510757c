"""What differentiating poses costs: errors of three ways to use the same poses, at two rates of them.

Run: python design/differentiating.py [seeds [seconds]] -o docs/data/differentiating.csv

A consumer-grade IMU in front of cameras whose errors are white. Poses alone: a spline of the poses, its derivatives,
and least squares for the readings. Inverse: a spline fitted to poses and readings together. Forward: the filter, with a
pose every half a second as usual, or with every pose.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.optimize import minimize_scalar

from kreisel.calibration.calibrate import ESTIMATORS
from kreisel.fitting.stored_state import stored_state
from kreisel.geometry.pose_spline import ORDER
from kreisel.geometry.rotation import Array, conjugate, matrix, multiply, skew
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.model.site import gravity_r
from kreisel.preparation.build_problem import build_problem
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.situations import BASES
from kreisel.study.truth import true_parameters
from kreisel.units import MG, PPM
from kreisel.validation.checks import check_streams

RATES = (83.0, 12.0)
"""Hz: of Fox and Janocha's robot, and of a slow one."""

SPACINGS = (0.05, 0.1, 0.2, 0.3, 0.4)
"""Spans of the spline of the poses alone, s: the best of them is taken, by truth."""

COLUMNS = ("poses a second", "way", "gyro scale", "gyro offset", "accelerometer scale", "accelerometer offset")


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", type=int, default=8)
    parser.add_argument("seconds", nargs="?", type=float, default=60.0)
    parser.add_argument("-o", "--output", type=Path)
    given = parser.parse_args()
    rows = [list(COLUMNS)]
    for rate in RATES:
        errors: dict[str, list[Array]] = {}
        for seed in range(1, given.seeds + 1):
            for way, error in _errors(rate, seed, given.seconds).items():
                errors.setdefault(way, []).append(error)
        for way, found in errors.items():
            rms = np.sqrt(np.mean(np.square(found), axis=(0, 2)))
            cells = (f"{rms[0]:.3g} ppm", f"{rms[1]:.2g} deg/h", f"{rms[2]:.3g} ppm", f"{rms[3]:.2g} mg")
            rows.append([f"{rate:.0f}", way, *cells])
            print(*rows[-1], sep="\t", flush=True)
    if given.output:
        with given.output.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows(rows)


def _errors(rate: float, seed: int, seconds: float) -> dict[str, Array]:
    """Return the errors (4, 3) of scale (ppm) and offset (deg/h, mg) of gyros and accelerometers, by way."""
    content = {table: dict(values) for table, values in BASES["mocap"].items()}
    del content["stated"]
    content["imu"] |= {"gyro_g_sensitivity_sd": 0.0, "gyro_g_squared_sd": 0.0}
    content["reference"] |= {"interval": 1.0 / rate}
    cell = Cell.model_validate({**content, "seed": seed, "seconds": seconds})
    truth, recording = simulate(cell, Path(f"differentiating-{seed}"))
    recording = check_streams(recording)
    out = {}
    for way, name, interval in (
        ("forward", "ekf", None), ("forward, every pose", "ekf", 1.0 / rate),
        ("inverse, every pose", "inverse", 1.0 / rate),
    ):  # fmt: skip
        settings = CalibrationSettings(update_interval=interval)
        problem = build_problem(prepare_recording(recording, settings), settings)
        estimator = ESTIMATORS[name]
        fit = estimator.refit(problem, estimator.fit(problem, gate=100.0), gate=100.0)
        true = true_parameters(truth, recording, problem, fit.parameters)
        away = stored_state(problem, fit.parameters) - stored_state(problem, true)
        out[way] = _quantities(*(away[problem.layout.stored(group)] for group in GROUPS))
    best = np.full((4, 3), np.inf)
    for spacing in SPACINGS:
        if spacing * rate < 2.0:
            continue  # more control points than poses
        found = np.array(_quantities(*_by_poses_alone(problem, true, spacing)))
        if np.sum(found**2 / _USUAL[:, None]) < np.sum(best**2 / _USUAL[:, None]):
            best = found
    return {"poses alone": best, **out}


GROUPS = ("gyro_cross_coupling", "gyro_offset", "accel_cross_coupling", "accel_offset")
_USUAL = np.array([1e3, 1e1, 1e3, 1e0]) ** 2
"""Sizes of the four errors that weigh alike in the choice of spans."""


def _quantities(gyro: Array, gyro_offset: Array, accel: Array, accel_offset: Array) -> Array:
    deg_h = np.degrees(3600.0)
    diagonal = [np.diag(np.reshape(K, (3, 3))) / PPM for K in (gyro, accel)]
    return np.array([diagonal[0], gyro_offset * deg_h, diagonal[1], accel_offset / MG])


def _by_poses_alone(problem: Problem, true: CellParameters, spacing: float) -> tuple[Array, Array, Array, Array]:
    """Return the errors of matrices and offsets from splines of the poses; gravity's magnitude is known."""
    reference, readings = problem.reference, problem.sensor.readings
    if reference.positions is None or reference.quaternions is None:
        raise SystemExit("poses alone need positions and orientations")
    at = true.clock.imu_time(reference.seconds)
    knots = np.arange(at[0], at[-1], spacing)[1:-1]
    knots = np.concatenate([np.full(ORDER, at[0]), knots, np.full(ORDER, at[-1])])
    curve = make_lsq_spline(at, np.hstack([reference.positions, reference.quaternions]), knots, k=ORDER - 1)
    inside = (readings.stamps > at[0] + 1.0) & (readings.stamps < at[-1] - 1.0)
    t, rates, forces = (x[inside] for x in (readings.stamps, readings.rates, readings.accelerations))
    late = minimize_scalar(lambda dt: _gyros(curve, t + dt, rates)[1], bounds=(-0.01, 0.01), method="bounded").x
    gyro = _gyros(curve, t + late, rates)[0]
    S_a, offset = _accelerometers(curve, t + late, forces, true)
    sensors = true.sensors
    return (
        (np.linalg.inv(gyro[:3].T) - sensors.K_omega).ravel(),
        -gyro[3] - sensors.k_w[0],
        (np.linalg.inv(S_a) - sensors.K_a).ravel(),
        -offset - sensors.k_a[0],
    )


def _motion(curve: BSpline, t: Array) -> tuple[Array, Array, Array, Array]:
    """Return attitude, rate and its derivative, and acceleration in r."""
    value, first, second = (curve.derivative(i)(t) if i else curve(t) for i in range(3))
    s, s1, s2 = value[:, 3:], first[:, 3:], second[:, 3:]
    square = np.sum(s * s, axis=1, keepdims=True)
    omega = 2.0 * multiply(conjugate(s), s1)[:, 1:] / square
    change = omega * 2.0 * np.sum(s * s1, axis=1, keepdims=True) / square
    alpha = 2.0 * multiply(conjugate(s), s2)[:, 1:] / square - change
    return s / np.sqrt(square), omega, alpha, second[:, :3]


def _gyros(curve: BSpline, t: Array, rates: Array) -> tuple[Array, float]:
    """Return the least squares of rates, (4, 3), and the sum of squares that they leave."""
    _, omega, _, _ = _motion(curve, t)
    found, left, *_ = np.linalg.lstsq(np.column_stack([omega, np.ones(t.size)]), rates, rcond=None)
    return np.asarray(found, dtype=float), float(left.sum())


def _accelerometers(curve: BSpline, t: Array, forces: Array, true: CellParameters) -> tuple[Array, Array]:
    """Return sensitivities (3, 3) and offsets (3,) of the accelerometers; arms and tilt are found, too."""
    q, omega, alpha, a = _motion(curve, t)
    field = skew(alpha) + skew(omega) @ skew(omega)
    turned = np.swapaxes(matrix(q), 1, 2)
    g, arms, S = (
        gravity_r(true) + np.array([0.05, -0.05, 0.0]),
        np.zeros((3, 3)),
        np.asarray(np.linalg.inv(true.sensors.K_a), dtype=float),
    )
    offset = np.zeros(3)
    for _ in range(3):
        f = np.einsum("mij,mj->mi", turned, a - g)
        J, e = [], []
        for j in range(3):
            inner = f + np.einsum("mxy,y->mx", field, arms[j])
            own = np.zeros((t.size, 24))
            own[:, 3 * j : 3 * j + 3] = inner
            own[:, 9 + j] = 1.0
            own[:, 12 + 3 * j : 15 + 3 * j] = np.einsum("x,mxy->my", S[j], field)
            own[:, 21:] = -np.einsum("x,mxy->my", S[j], turned)
            J.append(own)
            e.append(forces[:, j] - inner @ S[j] - offset[j])
        along = g / np.linalg.norm(g)
        known = 1e6 * np.concatenate([np.zeros(21), along])  # the magnitude stays as it is
        size = 1e6 * (true.gravity - np.linalg.norm(g))
        step = np.linalg.lstsq(np.vstack([*J, known]), np.concatenate([*e, [size]]), rcond=None)[0]
        S = S + step[:9].reshape(3, 3)
        offset, arms, g = offset + step[9:12], arms + step[12:21].reshape(3, 3), g + step[21:]
    return np.asarray(S, dtype=float), np.asarray(offset, dtype=float)


if __name__ == "__main__":
    main()

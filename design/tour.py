"""The pictures and numbers of the tour: one simulated device from its raw file to a flight.

Run: python design/tour.py PICTURES [TABLE.csv]. Pictures are SVG. The flight is not part of the recording: its readings
are made from the device's true parameters, and integrated twice, as they are and corrected by the calibration.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from kreisel import plot
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.geometry.rotation import Array, apply, conjugate, exp, log, matrix, multiply, nearest_rotation
from kreisel.inertial.noise_figures import GRADES, noise
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.simulation.imu import ideal_readings
from kreisel.units import DEG

RATE, SECONDS, GRADE = 200.0, 60.0, "industrial-mems"
"""Hz, and s of the flight; the device's grade."""

REST = 5.0
"""Seconds that the aircraft stands before: its own offsets of the gyros are measured then, as flight controllers do."""

GRAVITY = np.array([0.0, 0.0, -9.81])
"""m/s^2, in a frame with z upward; Earth's rotation is left out of the flight and of its integration alike."""

COLOURS = ("#0b62a4", "#d1510a", "#2a8a3e")
"""Of x, y, z, as in reports."""


def main(pictures: Path, table: Path | None) -> None:
    """Write pictures and table."""
    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "tour"  # the same file from the same numbers
    pictures.mkdir(parents=True, exist_ok=True)
    cell = Cell.model_validate({"seed": 11, "seconds": 240.0, "imu": {"grade": GRADE}})
    truth, recording = simulate(cell, Path("tour"))
    outcome = run_calibration(recording, CalibrationSettings(), validate=True, budget=True)
    calibration = replace(outcome.calibration, updates=outcome.estimate.run.history)
    for name, figure in (
        ("raw", _raw(recording)),
        ("directions", _directions(recording, calibration)),
        ("residuals", plot.residuals(calibration)),
        ("estimates", plot.estimates(calibration, "accel_offset", truth)),
        ("parameters", plot.parameters(calibration)),
        ("budget", plot.budget(calibration)),
        ("validation", _validation(outcome)),
    ):
        _save(figure, pictures / f"tour-{name}.svg")
    seconds, errors = _flight(truth, calibration)
    _save(_flown(seconds, errors), pictures / "tour-flight.svg")
    if table is not None:
        _write(seconds, errors, table)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")


def _raw(recording: Recording) -> Figure:
    """Return what the file holds: rates and accelerations of half a minute."""
    imu = recording.imu
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    part = (imu.seconds > 30.0) & (imu.seconds < 60.0)
    for ax, values, unit in zip(
        axes, (imu.rates / DEG, imu.accelerations), ("Rate (deg/s)", "Acceleration (m/s²)"), strict=True
    ):
        for i, colour in enumerate(COLOURS):
            ax.plot(imu.seconds[part], values[part, i], color=colour, lw=0.8, label="xyz"[i])
        ax.set_ylabel(unit)
    axes[0].legend(ncols=3, loc="upper right")
    axes[1].set_xlabel("Time (s)")
    return figure


def _directions(recording: Recording, calibration: Calibration) -> Figure:
    """Return the directions of gravity in the device while it stood, seen from two sides."""
    imu = recording.imu
    still = np.linalg.norm(imu.rates - np.median(imu.rates, axis=0), axis=1) < 1.5 * DEG
    f = imu.accelerations[still][::20] @ nearest_rotation(calibration.sensors.K_a).T
    f /= np.linalg.norm(f, axis=1)[:, None]
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    for ax, side, word in zip(figure.subplots(1, 2), (1.0, -1.0), ("z up", "z down"), strict=True):
        half = side * f[:, 2] > 0.0
        ax.add_patch(matplotlib.patches.Circle((0, 0), 1.0, fill=False, color="0.5"))
        ax.plot(f[half, 0], f[half, 1], ".", color=COLOURS[0], ms=4)
        ax.set(aspect="equal", xlim=(-1.1, 1.1), ylim=(-1.1, 1.1), title=word, xlabel="x", ylabel="y")
    return figure


def _validation(outcome: Outcome) -> Figure:
    """Return the drift of navigation over the part that was not used."""
    found = outcome.cross
    if found is None:
        raise SystemExit("no cross-validation")
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    ax = figure.subplots()
    for drift, colour, word in (
        (found.nominal, COLOURS[1], "nominal parameters"),
        (found.calibrated, COLOURS[0], "calibrated"),
    ):
        ax.semilogy(drift.seconds, 1e3 * drift.position, ".", color=colour, ms=3, label=word)
    ax.set(xlabel="Time (s)", ylabel="Position error (mm)")
    ax.legend()
    return figure


def _flight(truth: Truth, calibration: Calibration) -> tuple[Array, dict[str, Array]]:
    """Return stamps, and position errors (n,) of a flight in m, raw and corrected."""
    t, q, p, omega, alpha, force = _motion()
    rng, grade = np.random.default_rng(5), GRADES[GRADE]
    rates, accelerations = ideal_readings(omega, alpha, force, truth.sensors, truth.effects)
    rates = rates + noise(rng, t.size, RATE, grade.gyro_noise_density, 0.0, 0.0)
    accelerations = accelerations + noise(rng, t.size, RATE, grade.accel_noise_density, 0.0, 0.0)
    turn = nearest_rotation(calibration.sensors.K_a)  # as delivered: in the body's axes by the mount alone
    readings = {
        "as delivered": (rates @ turn.T, accelerations @ turn.T),
        "corrected": calibration.correct(rates, accelerations, t),
    }
    rest = t < REST
    out = {}
    for name, (w, f) in readings.items():
        out[name] = np.linalg.norm(_integrated(t, w - w[rest].mean(axis=0), f, q[0], p[0]) - p, axis=1)
    return t - REST, out


def _motion() -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return stamps, attitude, position, and rate, angular acceleration and specific force in b, of a flight.

    After a rest figures of eight with turns of 60 degrees of bank; rates by differences of a path with steps of 1/8.
    """
    fine = 8
    h = 1.0 / (RATE * fine)
    t = np.asarray(h * np.arange(int(RATE * fine * (REST + SECONDS)) + 2))
    s = np.clip(t - REST, 0.0, None)
    ramp = 1.0 - np.exp(-((s / 4.0) ** 3))
    p = np.stack([25.0 * np.sin(0.45 * s), 15.0 * np.sin(0.9 * s), 6.0 + 3.0 * np.cos(0.3 * s)], axis=1) * ramp[:, None]
    roll, pitch, yaw = (
        60 * DEG * np.sin(0.9 * s) * ramp,
        25 * DEG * np.sin(0.7 * s) * ramp,
        2.2 * np.sin(0.45 * s) * ramp,
    )
    zero = np.zeros_like(s)
    q = multiply(
        multiply(exp(np.stack([zero, zero, yaw], 1)), exp(np.stack([zero, pitch, zero], 1))),
        exp(np.stack([roll, zero, zero], 1)),
    )
    omega = log(multiply(conjugate(q[:-1]), q[1:])) / h
    alpha = np.gradient(omega, h, axis=0)
    a = np.gradient(np.gradient(p, h, axis=0), h, axis=0)[:-1]
    force = apply(conjugate(q[:-1]), a - GRAVITY)
    # readings are means over their interval, as the integration below takes them
    n = omega.shape[0] // fine

    def mean(x: Array) -> Array:
        return np.asarray(x[: n * fine].reshape(n, fine, 3).mean(axis=1))

    return t[: n * fine : fine], q[: n * fine : fine], p[: n * fine : fine], mean(omega), mean(alpha), mean(force)


def _integrated(t: Array, omega: Array, force: Array, q: Array, p: Array) -> Array:
    """Return positions (n, 3) by plain strapdown integration from rest."""
    h, v, out = float(t[1] - t[0]), np.zeros(3), np.empty((t.size, 3))
    for k in range(t.size):
        out[k] = p
        middle = multiply(q, exp(0.5 * h * omega[k]))
        a = matrix(middle) @ force[k] + GRAVITY
        p = p + h * v + 0.5 * h**2 * a
        v = v + h * a
        q = multiply(q, exp(h * omega[k]))
    return out


def _flown(seconds: Array, errors: dict[str, Array]) -> Figure:
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    ax = figure.subplots()
    for (name, error), colour in zip(errors.items(), (COLOURS[1], COLOURS[0]), strict=True):
        ax.semilogy(seconds, np.maximum(error, 1e-3), color=colour, label=name)
    ax.set(xlabel="Time of flight (s)", ylabel="Position error (m)", xlim=(0.0, SECONDS), ylim=(1e-3, None))
    ax.legend()
    return figure


def _write(seconds: Array, errors: dict[str, Array], table: Path) -> None:
    with table.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["seconds of flight", *(f"position error {name}, m" for name in errors)])
        for at in (10.0, 20.0, 30.0, 60.0):
            i = min(int(np.searchsorted(seconds, at)), seconds.size - 1)
            writer.writerow([f"{at:.0f}", *(f"{error[i]:.3g}" for error in errors.values())])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)

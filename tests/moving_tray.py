"""Calibrated IMUs of different noise on one body, moved from rest to rest by a motion in closed form."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.calibration.result import Calibration, write_document
from kreisel.inertial.sensor_model import SensorParameters, size_effect
from kreisel.recording.recording import ImuSamples

from .unit.calibration.example import calibration

START_NS = 1_700_000_000_000_000_000
MOVE, REST = 1.2, 2.3
RATE = 200.0
NOISE = np.array([[1.0e-4, 8.0e-4], [2.0e-4, 12.0e-4], [1.4e-4, 20.0e-4], [3.0e-4, 10.0e-4]])
"""Noise densities of the gyros, rad/s/sqrt(Hz), and of the accelerometers, m/s^2/sqrt(Hz), of each unit."""

MOUNTS = ((0.05, -0.1, 1.5), (2.9, 0.3, -0.4), (0.2, 1.3, 0.1), (-1.2, 0.4, 0.8))
CLOCKS = ((0.0, 0.0), (-3.217, 30e-6), (41.03, -30e-6), (0.0008, 12e-6))
"""Offset, s, and drift of the clock of each unit against true time."""


class Motion:
    """Angular rate, angular acceleration and specific force of b; `rests` False: one move follows the other."""

    def __init__(self, seed=1, *, rests=True):
        rng = np.random.default_rng(seed)
        self._rest = REST if rests else 0.0
        self._turns = rng.normal(0.0, 0.6, (400, 3))
        forces = rng.normal(size=(401, 3))
        self._forces = 9.81 * forces / np.linalg.norm(forces, axis=1)[:, None]

    def at(self, t):
        period = MOVE + self._rest
        move = np.clip((t // period).astype(int), 0, 399)
        x = np.clip((t - move * period - self._rest) / MOVE, 0.0, 1.0)
        share = (x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3))[:, None]
        bump = (140.0 * (x * (1.0 - x)) ** 3 / MOVE)[:, None]
        rise = (420.0 * (x * (1.0 - x)) ** 2 * (1.0 - 2.0 * x) / MOVE**2)[:, None]
        turn, before, after = self._turns[move], self._forces[move], self._forces[move + 1]
        return bump * turn, rise * turn, before + share * (after - before)


def moved(t, *, rests=True):
    """Return whether the body moves at times (n,)."""
    return (t % (MOVE + REST) > REST) | (not rests)


@dataclass(frozen=True)
class Device:
    """A unit: its calibration, which is exact, its clock, and its noise."""

    name: str
    calibration: Calibration
    offset: float
    drift: float
    phase: float
    noise: np.ndarray

    def record(self, motion, seconds, path=Path("recording"), noise=1.0, rate=RATE):
        """Return raw readings; noise: factor on its own; rate: samples a second."""
        rng = np.random.default_rng(int(self.name[3:]))
        t = (np.arange(round(seconds * rate)) + self.phase) / rate
        omega, alpha, f = motion.at(t)
        p = self.calibration.sensors
        white = noise * rate**0.5 * rng.normal(size=(2, t.size, 3)) * self.noise[:, None, None]
        rates = (omega + white[0]) @ np.linalg.inv(p.K_omega).T - p.k_w[0]
        accelerations = (f + white[1]) @ np.linalg.inv(p.K_a).T - p.k_a[0] + size_effect(omega, alpha, p)
        stamps = START_NS + np.round((t + self.offset + self.drift * t) * 1e9).astype(np.int64)
        return ImuSamples(stamps, rates, accelerations, path / self.name / "data.csv")


def devices(count=4):
    """Return units on one body, turned and placed differently, with clocks of their own."""
    out = []
    for k in range(count):
        own = calibration(MOUNTS[k], seed=3 + k)
        p = own.sensors
        sensors = SensorParameters(p.K_omega, p.k_w[:1], p.K_a, p.k_a[:1], 0.3 * p.lever_arms + [0.04 * k, 0.0, 0.0])
        out.append(Device(f"imu{k}", replace(own, sensors=sensors), *CLOCKS[k], 0.27 * k, NOISE[k]))
    return tuple(out)


def write_result(folder, units, left_out=()):
    """Write the result folder of a tray with these calibrations."""
    place = {
        "position": [0.0, 0.0, 0.0],
        "rotation": np.eye(3).tolist(),
        "rotation_vector": [0.0, 0.0, 0.0],
        "standard_deviation": {"position": [1e-4] * 3, "rotation": [1e-4] * 3},
        "clock": {"offset": 0.0, "offset_sd": 1e-5, "skew": 0.0, "skew_sd": 1e-7},
    }
    for unit in units:
        unit.calibration.save(folder / unit.name)
    imus = {unit.name: dict(place) for unit in units[1:]}
    document = {"schema": "kreisel-array-1", "reference": units[0].name, "imus": imus, "left_out": dict(left_out)}
    write_document(document, folder / "array.yaml")
    return folder

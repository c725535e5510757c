"""A small cell: a body moved from rest to rest, an IMU of the fibre-optic and MEMS kind, noisy poses.

Each move turns about one axis and shifts along one line, both with the same smooth course of time, so
that rates and accelerations are known in closed form.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.geometry.rotation import (
    Array,
    Indices,
    Mask,
    apply,
    conjugate,
    exp,
    from_matrix,
    multiply,
    nearest_rotation,
)
from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import SensorParameters, size_effect
from kreisel.recording.recording import ImuSamples, Recording, ReferencePoses
from kreisel.recording.recording_settings import ImuTable, RecordingSettings, ReferenceTable, SiteTable

_LATITUDE = math.radians(49.2571)  # Saarbrücken, where the paper was written
_POSE_INTERVAL = 0.012
_MOVE, _REST, _FIRST_REST = 2.5, 1.5, 3.0
_START_NS = 1_000_000_000_000
_CLOCK_OFFSET = 0.0271
_POSITION_SD, _ORIENTATION_SD = 0.5e-3, 0.5e-3
_STILL_POSITION_SD, _STILL_ORIENTATION_SD = 0.1e-3, 0.1e-3


@dataclass(frozen=True)
class Truth:
    """What the simulated recording was made from."""

    sensors: SensorParameters
    time_offset: float
    gravity_r: Array


@dataclass(frozen=True)
class _Motion:
    """Moves from rest to rest: starting poses, total turns (b) and shifts (r) of each move."""

    q: Array
    p: Array
    turn: Array
    shift: Array

    def at(self, t: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return q, p, v, a in r and rate, angular acceleration of b against r in b."""
        period = _MOVE + _REST
        move = np.clip(((t - _FIRST_REST) // period).astype(int), 0, len(self.turn) - 1)
        x = np.clip((t - _FIRST_REST - move * period) / _MOVE, 0.0, 1.0)
        s = x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)
        ds = 140.0 * (x * (1.0 - x)) ** 3 / _MOVE
        dds = 420.0 * (x * (1.0 - x)) ** 2 * (1.0 - 2.0 * x) / _MOVE**2
        turn, shift = self.turn[move], self.shift[move]
        q = multiply(self.q[move], exp(s[:, None] * turn))
        return (
            q,
            self.p[move] + s[:, None] * shift,
            ds[:, None] * shift,
            dds[:, None] * shift,
            ds[:, None] * turn,
            dds[:, None] * turn,
        )

    def rest(self, t: Array) -> tuple[Mask, Indices]:
        """Return whether t lies in a rest, and which."""
        period = _MOVE + _REST
        phase = (t - _FIRST_REST) % period
        number = np.floor((t - _FIRST_REST) / period).astype(int) + 1
        resting = (t < _FIRST_REST) | (phase > _MOVE)
        return resting, np.where(phase > _MOVE, number, number - 1) + 1


def _moves(rng: np.random.Generator, count: int) -> _Motion:
    q, p = np.array([0.0, 1.0, 0.0, 0.0]), np.array([1.5, 0.0, 1.2])
    home = p.copy()
    columns: list[list[Array]] = [[], [], [], []]
    for _ in range(count):
        axis = rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(1.2, 2.4)
        shift = home + rng.uniform(-0.5, 0.5, size=3) - p
        for column, value in zip(columns, (q, p, turn, shift), strict=True):
            column.append(value)
        q, p = multiply(q, exp(turn)), p + shift
    return _Motion(*(np.array(column) for column in columns))


def _sensors(rng: np.random.Generator) -> SensorParameters:
    grade = GRADES["fog-mems"]

    def cross_coupling() -> Array:
        return np.asarray(np.eye(3) + rng.normal(0.0, 8e-3, size=(3, 3)))

    return SensorParameters(
        K_omega=cross_coupling(),
        k_w=rng.normal(0.0, grade.gyro_offset_sd, size=(1, 3)),
        K_a=cross_coupling(),
        k_a=rng.normal(0.0, grade.accel_offset_sd, size=(1, 3)),
        lever_arms=np.array([0.02, 0.03, 0.08]) + rng.normal(0.0, 0.02, size=(3, 3)),
    )


def simulate(rng: np.random.Generator, seconds: float, path: Path, imu_rate: float = 200.0) -> tuple[Truth, Recording]:
    """Return a recording of a small cell, and its truth; nothing is written.

    Parameters
    ----------
    seconds
        Length of the recording.
    path
        The recording's name.
    imu_rate
        Samples a second.
    """
    count = max(1, math.ceil((seconds - _FIRST_REST) / (_MOVE + _REST)))
    motion, sensors = _moves(rng, count), _sensors(rng)
    gravity_n = normal_gravity(_LATITUDE)
    tilt = nearest_rotation(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
    q_rn = multiply(from_matrix(tilt), exp(rng.normal(0.0, 2e-3, size=3)))
    gravity, earth = apply(q_rn, np.array([0.0, 0.0, gravity_n])), apply(q_rn, earth_rate_n(_LATITUDE))
    t = np.arange(round(seconds * imu_rate) + 1) / imu_rate
    imu = _readings(rng, motion, sensors, t, gravity, earth, path)
    poses = _poses(rng, motion, seconds, path)
    grade = GRADES["fog-mems"]
    settings = RecordingSettings(
        imu=ImuTable(
            gyro_noise_density=grade.gyro_noise_density,
            accel_noise_density=grade.accel_noise_density,
            gyro_offset_sd=grade.gyro_offset_sd,
            accel_offset_sd=grade.accel_offset_sd,
        ),
        site=SiteTable(latitude_deg=math.degrees(_LATITUDE), height_m=0.0),
        reference=ReferenceTable(
            kind="robot",
            position_sd=_POSITION_SD,
            orientation_sd=_ORIENTATION_SD,
            standstill_position_sd=_STILL_POSITION_SD,
            standstill_orientation_sd=_STILL_ORIENTATION_SD,
        ),
    )
    return Truth(sensors, _CLOCK_OFFSET, gravity), Recording(path, imu, poses, None, settings)


def _readings(
    rng: np.random.Generator,
    motion: _Motion,
    sensors: SensorParameters,
    t: Array,
    gravity: Array,
    earth: Array,
    path: Path,
) -> ImuSamples:
    """Return readings: the sensor model of equations (1) and (2) solved for the raw values, plus noise."""
    q, _, v, a, rate, alpha = motion.at(t)
    back = conjugate(q)
    earth_b = apply(back, np.broadcast_to(earth, rate.shape))
    omega = rate + earth_b
    alpha_ib = alpha - np.cross(rate, earth_b)
    force = apply(back, a - gravity + 2.0 * np.cross(earth, v))
    grade, root = GRADES["fog-mems"], math.sqrt(1.0 / (t[1] - t[0]))
    raw_rate = omega @ np.linalg.inv(sensors.K_omega).T - sensors.k_w[0]
    raw_force = force @ np.linalg.inv(sensors.K_a).T + size_effect(omega, alpha_ib, sensors) - sensors.k_a[0]
    stamps = _START_NS + np.round(t * 1e9).astype(np.int64)
    return ImuSamples(
        stamps,
        raw_rate + rng.normal(0.0, grade.gyro_noise_density * root, size=raw_rate.shape),
        raw_force + rng.normal(0.0, grade.accel_noise_density * root, size=raw_force.shape),
        path / "imu0" / "data.csv",
    )


def _poses(rng: np.random.Generator, motion: _Motion, seconds: float, path: Path) -> ReferencePoses:
    """Return poses with white errors on the path and one error for each rest, on the robot's own clock."""
    t = np.arange(0.05, seconds - 0.05, _POSE_INTERVAL)
    q, p, *_ = motion.at(t)
    resting, number = motion.rest(t)
    rests = int(number.max()) + 1
    still_p = rng.normal(0.0, _STILL_POSITION_SD, size=(rests, 3))[number]
    still_q = rng.normal(0.0, _STILL_ORIENTATION_SD, size=(rests, 3))[number]
    path_p = rng.normal(0.0, _POSITION_SD, size=p.shape)
    path_q = rng.normal(0.0, _ORIENTATION_SD, size=p.shape)
    choose = resting[:, None]
    stamps = _START_NS + np.round((t - _CLOCK_OFFSET) * 1e9).astype(np.int64)
    return ReferencePoses(
        "pose0",
        stamps,
        p + np.where(choose, still_p, path_p),
        multiply(q, exp(np.where(choose, still_q, path_q))),
        path / "pose0" / "data.csv",
    )


def write_truth(truth: Truth, file: Path) -> None:
    """Write the truth beside a recording; no estimator reads it."""
    s = truth.sensors
    document = {
        "gyroscope": {"cross_coupling": s.K_omega.tolist(), "offset": s.k_w[0].tolist()},
        "accelerometer": {
            "cross_coupling": s.K_a.tolist(),
            "offset": s.k_a[0].tolist(),
            "lever_arms": s.lever_arms.tolist(),
        },
        "time_offset": truth.time_offset,
        "gravity_in_base": truth.gravity_r.tolist(),
    }
    file.write_text(json.dumps(document, indent=1), encoding="utf-8")

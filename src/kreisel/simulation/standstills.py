"""A recording of a device that somebody lays down, or holds, in many attitudes, without a reference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from kreisel.geometry.rotation import Array, apply, conjugate, exp, from_two_vectors, log, multiply
from kreisel.inertial.earth import earth_rate_n
from kreisel.inertial.noise_figures import GRADES, noise
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.recording.recording import ImuSamples, Recording, Stamps, TableAngles
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.simulation.cell_settings import Imu
from kreisel.simulation.device_errors import DeviceEffects
from kreisel.simulation.imu import draw_sensors, ideal_readings, rounded

_TABLE_LATE = 40_000_000
"""ns: by how much a turntable's clock is ahead."""

_CORRECTIONS = 8
"""Each makes what is left of a cubic term smaller by three times its share of the reading."""

_LONG = 15.0
"""rad: a turn beyond this is one by a motor."""

LATITUDE, GRAVITY, GRAVITY_SD = np.radians(48.0), 9.8089, 1e-4
"""Where it is, rad, and what is stated of gravity there, m/s^2: the true one differs by as much."""


@dataclass(frozen=True)
class HandTurns:
    """How a device is handled, and what is wrong with that.

    Attributes
    ----------
    grade
        Of the device.
    attitudes
        Number of standstills; `tilt` limits how far any is turned from the first, rad.
    rest, turn
        Seconds at each and in between, on average.
    tremor
        Rms angle of a hand's tremor at standstills, rad, at about 6 Hz.
    creep
        Angle by which each standstill slowly turns, rad.
    twist
        rad/s: rate at which every standstill turns, about the same axis of the device.
    slip
        Angle by which one in six standstills slips suddenly in its middle, rad.
    vibration
        m/s^2 rms, at standstills too.
    warm_up
        Excess of the offsets at the beginning, in units of the grade's usual offsets; it decays in a minute.
    quadratic
        Of the accelerometers, per m/s^2.
    gyro_cubic
        Standard deviation of cubic terms of the gyros, (rad/s)^-2.
    jitter
        s: standard deviation of when a sample is taken, against its stamp.
    lost
        Share of samples that are lost, while stamps are counted.
    range_share
        Largest rate that is read, over that of the turns.
    laid
        Anyhow; on the six faces of a case in turn, `attitudes` in all; the same with a whole turn on three of them; on
        a turntable, in three mountings; or the same on a hinge, of whose turns nobody writes down anything.
    laid_error, heading_error, heading_bias
        rad: of each standstill on a face, and of the heading after a whole turn; by what all of these turn too little.
    one_sense
        Whether all whole turns go the same way round, seen from above to the right.
    squareness
        Of the angles between faces, rad.
    slope
        Of the table on which faces are laid, rad about two horizontal axes.
    by_a_stop
        Whether faces are laid against a stop, so that each has the same heading again.
    table_axis, table_tilt, table_error
        Of a turntable, or a hinge: its axis in the local level, how far that is off, and the error of each of its
        turns, rad.
    table_scale
        Error of its scale: of rates then, which are recorded instead of angles.
    spin, spin_rate
        Revolutions of the first turn in each mounting on a hinge, as a drill turns, and its mean rate, rad/s.
    off_axis
        m: distance of the device from the axis of a hinge.
    """

    grade: str = "consumer-mems"
    attitudes: int = 24
    tilt: float = np.pi
    rest: float = 4.0
    turn: float = 2.0
    tremor: float = 0.0
    creep: float = 0.0
    twist: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slip: float = 0.0
    vibration: float = 0.0
    warm_up: float = 0.0
    quadratic: float = 0.0
    gyro_cubic: float = 0.0
    jitter: float = 0.0
    lost: float = 0.0
    range_share: float = 0.0
    laid: Literal["anyhow", "faces", "whole turns", "turntable", "hinge"] = "anyhow"
    laid_error: float = 3e-3
    heading_error: float = 5e-3
    heading_bias: float = 0.0
    one_sense: bool = False
    squareness: float = 2e-3
    slope: tuple[float, float] = (0.0, 0.0)
    by_a_stop: bool = False
    table_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    table_tilt: float = 0.02
    table_error: float = 1e-4
    table_scale: float = 0.0
    spin: float = 0.0
    spin_rate: float = 6.0
    off_axis: float = 0.0


@dataclass(frozen=True)
class _Move:
    """From an attitude (4,) to the next: first by a rotation vector in the local level (3,), nothing for a hand's."""

    there: Array
    vector: Array | None = None


def hand_turned(how: HandTurns, rng: np.random.Generator) -> tuple[SensorParameters, Recording]:
    """Return the true parameters in the frame of b, and a recording.

    Notes
    -----
    Between two standstills two rotations follow each other and overlap, each with a smooth profile: the rates are
    closed forms.
    """
    grade = GRADES[how.grade]
    truth = draw_sensors(rng, Imu(grade=how.grade), grade)
    truth = replace(truth, lever_arms=np.zeros((3, 3)))
    if how.quadratic:
        k_a = np.vstack([truth.k_a[:1], rng.normal(0.0, how.quadratic, (1, 3))])
        truth = replace(truth, k_a=k_a, k_w=np.vstack([truth.k_w[:1], np.zeros((1, 3))]))
    rate = grade.rate
    q, omega, moving, angle = _motion(how, rate, rng)
    n = len(q)
    earth = apply(conjugate(q), np.broadcast_to(earth_rate_n(float(LATITUDE)), (n, 3)))
    gravity = GRAVITY + rng.normal(0.0, GRAVITY_SD)
    force = apply(conjugate(q), np.broadcast_to([0.0, 0.0, -gravity], (n, 3)))
    shaken = how.vibration * np.sqrt(2.0) * np.sin(2.0 * np.pi * 0.37 * rate * np.arange(n) / rate)
    if how.off_axis:
        arm = how.off_axis * np.array([0.6, -0.64, 0.48])
        force = force + np.cross(omega, np.cross(omega, arm)) + np.cross(np.gradient(omega, 1.0 / rate, axis=0), arm)
    force = force + shaken[:, None] * np.array([0.6, 0.0, 0.8]) + moving[:, None] * rng.normal(0.0, 1.0, (1, 3))
    effects = replace(DeviceEffects.none(), g_sensitivity=rng.normal(0.0, grade.g_sensitivity / 3.0, (3, 3)))
    w, a = ideal_readings(omega + earth, np.zeros((n, 3)), force, truth, effects)
    cubes = {}
    if how.gyro_cubic:
        cubes = {"gyro_cubic": rng.normal(0.0, how.gyro_cubic, 3)}
        w = _bent(w, cubes["gyro_cubic"])
    if how.jitter:
        slope = np.gradient(w, 1.0 / rate, axis=0)
        w = w + slope * rng.normal(0.0, how.jitter, (n, 1))
    decay = how.warm_up * np.exp(-np.arange(n) / rate / 60.0)[:, None]
    w = w + decay * grade.gyro_offset_sd * rng.normal(size=3) * 0.1
    a = a + decay * grade.accel_offset_sd * rng.normal(size=3) * 0.1
    of_gyro = noise(rng, n, rate, grade.gyro_noise_density, grade.gyro_bias_instability, grade.gyro_rate_random_walk)
    of_accel = noise(rng, n, rate, grade.accel_noise_density, grade.accel_bias_instability, grade.accel_random_walk)
    w, a = w + of_gyro, a + of_accel
    # the true offsets contain the mean of bias instability and random walk
    k_w, k_a = truth.k_w.copy(), truth.k_a.copy()
    k_w[0] -= of_gyro.mean(axis=0)
    k_a[0] -= of_accel.mean(axis=0)
    truth = replace(truth, k_w=k_w, k_a=k_a)
    if how.range_share:
        largest = how.range_share * float(np.abs(w).max())
        w = np.clip(w, -largest, largest)
    w, a = rounded(w, grade.gyro_step), rounded(a, grade.accel_step)
    keep = rng.random(n) >= how.lost
    stamps: Stamps = np.round(np.arange(n) * 1e9 / rate).astype(np.int64)
    w, a = w[keep], a[keep]
    truth = replace(truth, others={"gyro_g_sensitivity": effects.g_sensitivity.ravel(), **cubes})
    table = None
    if how.laid == "turntable":
        every = max(1, round(0.02 * rate))
        table = TableAngles(
            stamps[::every] + _TABLE_LATE, angle[::every], Path("table0"), by_rate=bool(how.table_scale)
        )
    return truth, _recording(how, stamps[: len(w)], w, a, table)


def _bent(ideal: Array, cubic: Array) -> Array:
    """Return the readings r (n, 3) of which r + c r^3 is what a sensor without cubic terms would read."""
    out = ideal.copy()
    for _ in range(_CORRECTIONS):
        out = ideal - cubic * out**3
    return out


def _recording(how: HandTurns, stamps: Stamps, w: Array, a: Array, table: TableAngles | None) -> Recording:
    path = Path(f"hand-turned-{how.grade}")
    site = {"site": {"latitude_deg": float(np.degrees(LATITUDE)), "gravity": GRAVITY, "gravity_sd": GRAVITY_SD}}
    settings = RecordingSettings.model_validate(site)
    return Recording(path, ImuSamples(stamps, w, a, path), None, settings=settings, table=table)


def _motion(how: HandTurns, rate: float, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return attitudes (n, 4) from b to the local level, rates (n, 3), and what else happens.

    That is a pulse of acceleration in each turn by hand (n,), and the angle by which a table has turned (n,).
    """
    moves = _moves(how, rng)
    q, omega, pulse, angle = [], [], [], []
    turned = 0.0
    for k, move in enumerate(moves):
        rested = int(rate * how.rest * rng.uniform(0.7, 1.3))
        wobble, wobble_rate = _unrest(how, rested, rate, rng)
        q.append(multiply(move.there, exp(wobble)))
        omega.append(wobble_rate)
        pulse.append(np.zeros(rested))
        angle.append(np.full(rested, turned))
        if k + 1 == len(moves):
            break
        # the standstill ends where it has crept to
        there, vector, begin = moves[k + 1].there, moves[k + 1].vector, q[-1][-1]
        seconds = how.turn * rng.uniform(0.7, 1.4)
        if vector is not None:
            angle_of = float(np.linalg.norm(vector))
            seconds = angle_of / how.spin_rate if angle_of > _LONG else seconds * (1.0 + angle_of)
        t = np.arange(int(rate * seconds)) / rate / seconds
        first = rng.normal(0.0, 0.5, 3) if vector is None else apply(conjugate(begin), vector)
        second = log(multiply(conjugate(multiply(begin, exp(first))), there))
        share = 0.75 if vector is None else 1.0  # of the time each rotation takes
        s1, v1 = _smooth(t / share)
        s2, v2 = _smooth((t - 1.0 + share) / share)
        after = exp(second * s2[:, None])
        q.append(multiply(multiply(begin, exp(first * s1[:, None])), after))
        omega.append((apply(conjugate(after), first * v1[:, None]) + second * v2[:, None]) / (share * seconds))
        by_hand = vector is None or how.laid not in ("turntable", "hinge")
        pulse.append(by_hand * np.sin(2.0 * np.pi * t) * np.sin(np.pi * t) ** 2)
        way = 0.0 if vector is None or by_hand else _angle(how, vector)
        angle.append(turned + way * s1)
        turned += way
    return np.concatenate(q), np.concatenate(omega), np.concatenate(pulse), np.concatenate(angle)


def _angle(how: HandTurns, vector: Array) -> float:
    """Return by how much a table says that it has turned."""
    return float((1.0 + how.table_scale) * np.sign(vector @ how.table_axis) * np.linalg.norm(vector))


def _moves(how: HandTurns, rng: np.random.Generator) -> list[_Move]:
    """Return the standstills, and how each is reached."""
    if how.laid == "anyhow":
        return [_Move(q) for q in _attitudes(how, rng)]
    if how.laid in ("turntable", "hinge"):
        return _on_table(how, rng)
    angles = rng.normal(0.0, how.squareness, 3)
    normals = np.eye(3)
    for (i, j), a in zip(((0, 1), (0, 2), (1, 2)), angles, strict=True):
        normals[i, j] = normals[j, i] = 0.5 * a
    table = exp([*how.slope, 0.0])
    order = [k % 6 for k in range(how.attitudes)]
    out: list[_Move] = []
    for k in order:
        axis, sign = k // 2, 1.0 - 2.0 * (k % 2)
        up = sign * normals[axis]
        q = from_two_vectors(up / np.linalg.norm(up), [0.0, 0.0, -1.0])
        heading = (0.0 if how.by_a_stop else 1.0) * rng.uniform(-np.pi, np.pi)
        q = multiply(exp([0.0, 0.0, heading]), multiply(q, exp(rng.normal(0.0, how.laid_error, 3))))
        q = multiply(table, q)
        out.append(_Move(q))
        if how.laid == "whole turns" and sign > 0.0:
            tilt = rng.normal(0.0, 0.3 * how.laid_error, 3)
            sense = rng.choice([-1.0, 1.0])
            sense = 1.0 if how.one_sense else sense
            tilt[2] = rng.normal(0.0, how.heading_error) - sense * how.heading_bias
            turn = apply(table, sense * np.array([0.0, 0.0, 2.0 * np.pi]))
            out.append(_Move(multiply(exp(tilt), q), turn))
    return out


def _on_table(how: HandTurns, rng: np.random.Generator) -> list[_Move]:
    """Return standstills in three mountings on a table or hinge: axes x, y and z along its own, turned each time."""
    axis = np.array(how.table_axis) + rng.normal(0.0, how.table_tilt, 3)
    axis /= np.linalg.norm(axis)
    out: list[_Move] = []
    for mounting in range(3):
        q = from_two_vectors(np.eye(3)[mounting], -axis)
        q = multiply(q, exp(rng.normal(0.0, 0.02, 3)))
        out.append(_Move(q))
        for turn in range(how.attitudes // 3 - 1):
            largest = 12.0 if how.laid == "turntable" else 2.5
            vector = rng.uniform(0.5, largest) * rng.choice([-1.0, 1.0]) * axis
            vector *= 1.0 if turn or not how.spin else (1.0 + 2.0 * np.pi * how.spin / np.linalg.norm(vector))
            q = multiply(multiply(exp(vector), q), exp(rng.normal(0.0, how.table_error, 3)))
            out.append(_Move(q, vector))
    return out


def _attitudes(how: HandTurns, rng: np.random.Generator) -> Array:
    """Return attitudes (M, 4): spread over all directions, or within a tilt of the first."""
    out = rng.normal(size=(how.attitudes, 4))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    if how.tilt < np.pi:
        small = rng.normal(0.0, 1.0, (how.attitudes, 3))
        small *= how.tilt * rng.random((how.attitudes, 1)) / np.linalg.norm(small, axis=1, keepdims=True)
        small[:, 2] = rng.uniform(-np.pi, np.pi, how.attitudes)
        out = exp(small)
    return out


def _smooth(x: Array) -> tuple[Array, Array]:
    """Return 0 to 1 with no rate and acceleration at either end, and the derivative."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2


def _unrest(how: HandTurns, n: int, rate: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return rotation vectors (n, 3) by which a standstill is none, and their rates."""
    t = np.arange(n) / rate
    ramp = t / t[-1]
    angle, speed = np.zeros((n, 3)), np.zeros((n, 3))
    if how.tremor:
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        frequency = 2.0 * np.pi * rng.uniform(4.0, 8.0, 3)
        size = how.tremor * np.sqrt(2.0)
        angle += size * (np.sin(frequency * t[:, None] + phase) - np.sin(phase))
        speed += size * frequency * np.cos(frequency * t[:, None] + phase)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    angle += how.creep * direction * ramp[:, None] + np.array(how.twist) * t[:, None]
    speed += how.creep * direction / t[-1] + np.array(how.twist)
    if how.slip and rng.random() < 1.0 / 6.0:
        s, v = _smooth((t - 0.5 * t[-1]) / 0.05)
        angle += how.slip * direction * s[:, None]
        speed += how.slip * direction * v[:, None] / 0.05
    return angle, speed


class HandHeld:
    """A device in the hand of somebody who does what is asked for, piece by piece, without end.

    Attributes
    ----------
    truth
        Its parameters, in the frame of b.
    rate
        Hz.
    """

    def __init__(self, grade: str, rng: np.random.Generator) -> None:
        self._grade, self._rng = GRADES[grade], rng
        self.rate = self._grade.rate
        truth = replace(draw_sensors(rng, Imu(grade=grade), self._grade), lever_arms=np.zeros((3, 3)))
        g_sensitivity = rng.normal(0.0, self._grade.g_sensitivity / 3.0, (3, 3))
        self._effects = replace(DeviceEffects.none(), g_sensitivity=g_sensitivity)
        self.truth = replace(truth, others={"gyro_g_sensitivity": g_sensitivity.ravel()})
        self._q = np.array([1.0, 0.0, 0.0, 0.0])

    def hold(self, seconds: float) -> tuple[Array, Array]:
        """Return rates and accelerations, (n, 3) each, as read while it is held still."""
        n = max(1, int(seconds * self.rate))
        return self._read(np.tile(self._q, (n, 1)), np.zeros((n, 3)))

    def turn(self, up: Array, seconds: float = 2.0) -> tuple[Array, Array]:
        """Return readings while it is turned until a direction of its own (3,) is up, within some degrees."""
        up = np.asarray(up) + self._rng.normal(0.0, 0.05, 3)
        there = from_two_vectors(up / np.linalg.norm(up), [0.0, 0.0, -1.0])
        there = multiply(exp([0.0, 0.0, self._rng.uniform(-np.pi, np.pi)]), there)
        return self.rotate(log(multiply(conjugate(self._q), there)), seconds)

    def rotate(self, vector: Array, seconds: float) -> tuple[Array, Array]:
        """Return readings while it is turned by a rotation vector in its own axes (3,), rad."""
        vector = np.asarray(vector)
        n = int(seconds * self.rate)
        s, v = _smooth(np.arange(1, n + 1) / n)
        q = multiply(self._q, exp(vector * s[:, None]))
        self._q = q[-1]
        return self._read(q, vector * v[:, None] / seconds)

    def _read(self, q: Array, omega: Array) -> tuple[Array, Array]:
        n, grade = len(q), self._grade
        earth = apply(conjugate(q), np.broadcast_to(earth_rate_n(float(LATITUDE)), (n, 3)))
        force = apply(conjugate(q), np.broadcast_to([0.0, 0.0, -GRAVITY], (n, 3)))
        w, a = ideal_readings(omega + earth, np.zeros((n, 3)), force, self.truth, self._effects)
        w = w + self._rng.normal(0.0, grade.gyro_noise_density * np.sqrt(self.rate), (n, 3))
        a = a + self._rng.normal(0.0, grade.accel_noise_density * np.sqrt(self.rate), (n, 3))
        return rounded(w, grade.gyro_step), rounded(a, grade.accel_step)

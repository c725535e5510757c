"""The virtual cell: an arm moves an IMU, its controller reports poses, and all true values are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array, Mask, apply, conjugate, exp, from_matrix, log, multiply
from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.inertial.noise_figures import GRADES
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.robot import kinematics
from kreisel.robot.description import Arm
from kreisel.robot.excitation import home, random_plan
from kreisel.robot.kinematics import load_arm
from kreisel.robot.motion import Limits, Plan, Timeline, plan
from kreisel.robot.program import Program, read_program
from kreisel.simulation.cell_settings import Cell, Errors
from kreisel.simulation.controller import ArmErrors, Report, Sway, draw_errors, draw_sway, measured, swing
from kreisel.simulation.device_errors import (
    DeviceEffects,
    OffsetChange,
    Slip,
    at_mean_temperature,
    draw_effects,
    draw_slip,
    middle,
    offset_change,
    offset_drift,
    temperature_of,
    vibration,
    with_faults,
)
from kreisel.simulation.elastic_mount import ElasticMount
from kreisel.simulation.free_path import FreePath, free_path
from kreisel.simulation.imu import disturbed, draw_noise, draw_sensors, ideal_readings, stamped
from kreisel.simulation.owner_statements import as_stated
from kreisel.simulation.random_physics import RandomPhysics
from kreisel.simulation.reference import MARGIN, START_NS, Measure, ReferenceDraws, report_poses, with_heading
from kreisel.units import DEG

_Inertial = tuple[Array, Array, Array]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Truth:
    """True values of a simulated recording.

    Attributes
    ----------
    sensors
        The device's parameters.
    time_offset, time_skew
        t_imu = t_ref + offset + skew (t_ref - first t_ref).
    gravity_r, earth_rate_r : (3,)
        In the base's frame.
    arm
        Errors of the arm; `actual` is the arm with its geometric errors.
    effects, offset_change, slip
        Further terms of the device, what was added to its offsets, and its turn in the mount (None: none); `sensors`
        is the device before it turned, without what was added.
    position_scale
        Reported positions are longer by this share.
    position_heading
        Reported positions are turned about down by this, rad.
    reference_smoothing
        Standard deviation of the window over which reported poses are averaged, s.
    mount
        What the mount gives way by.
    """

    sensors: SensorParameters
    time_offset: float
    time_skew: float
    gravity_r: Array
    earth_rate_r: Array
    arm: ArmErrors
    actual: Arm
    effects: DeviceEffects = field(default_factory=DeviceEffects.none)
    offset_change: OffsetChange | None = None
    slip: Slip | None = None
    position_scale: float = 0.0
    position_heading: float = 0.0
    reference_smoothing: float = 0.0
    mount: ElasticMount = field(default_factory=ElasticMount.rigid)


_SAME_IN_ALL_RUNS = ("sensor", "effects", "arm", "site", "mount")
"""Streams of a cell that its recordings have in common: device, arm and place."""

_OWN_OF_UNITS = ("sensor", "imu", "effects", "slip", "drift", "faults", "stamps", "own_clock", "mount")
"""Streams that every IMU on a tool has for itself; motion, arm, poses and vibration are those of all."""

_UNITS = 1 << 24
"""Added to the number of an IMU, so that its random numbers are those of no run."""

_RUNS = 1 << 20
"""Added to the number of a run, so that its random numbers are those of no trial."""


@dataclass(frozen=True)
class _Streams:
    """Independent random streams: switching one error on does not change the others. New ones go last."""

    motion: np.random.Generator
    sensor: np.random.Generator
    imu: np.random.Generator
    arm: np.random.Generator
    path: np.random.Generator
    site: np.random.Generator
    jitter: np.random.Generator
    effects: np.random.Generator
    slip: np.random.Generator
    drift: np.random.Generator
    vibration: np.random.Generator
    faults: np.random.Generator
    sway: np.random.Generator
    clock: np.random.Generator
    reference: np.random.Generator
    stamps: np.random.Generator
    physics: np.random.Generator
    own_clock: np.random.Generator
    mount: np.random.Generator

    @classmethod
    def of(cls, cell: Cell, trial: int | None, unit: int = 0) -> _Streams:
        key = () if trial is None else (trial,)
        streams = cls._from(cell.seed, key)
        if cell.run != 0:
            same = {name: getattr(streams, name) for name in _SAME_IN_ALL_RUNS}
            streams = replace(cls._from(cell.seed, (*key, _RUNS + cell.run)), **same)
        if unit == 0:
            return streams
        of_unit, of_run = (cls._from(cell.seed, (*key, *more, _UNITS + unit)) for more in ((), (_RUNS + cell.run,)))
        own = {name: getattr(of_unit if name in _SAME_IN_ALL_RUNS else of_run, name) for name in _OWN_OF_UNITS}
        return replace(streams, **own)

    @classmethod
    def _from(cls, seed: int, key: tuple[int, ...]) -> _Streams:
        root = np.random.SeedSequence(seed, spawn_key=key)
        return cls(*(np.random.default_rng(child) for child in root.spawn(len(fields(cls)))))


def simulate(
    cell: Cell,
    path: Path,
    progress: Progress | None = None,
    trial: int | None = None,
    program: Program | None = None,
    unit: int = 0,
) -> tuple[Truth, Recording]:
    """Return the recording of a virtual cell, and its true values; nothing is written.

    Parameters
    ----------
    path
        The recording's name.
    trial
        Number of a trial of a study: its random numbers come from that child of the cell's seed.
    program
        What the arm does, in the place of the cell's motion; its moves are straight in joint angles.
    unit
        Number of the IMU on the tool; see `cell_settings.Tray`.

    Raises
    ------
    RobotError
        If the arm, or a pose of the program, is not possible.
    """
    if cell.motion.kind != "arm":  # what an arm errs by from rest to rest
        none = {"repeatability_position_sd": 0.0, "repeatability_orientation_sd": 0.0}
        cell = cell.model_copy(update={"errors": cell.errors.model_copy(update=none)})
    cell, streams = _cell_of(cell, unit), _Streams.of(cell, trial, unit)
    say = progress or (lambda _step, _share: None)
    say("plan motion", 0.0)
    nominal = load_arm(cell.robot.model, cell.robot.tcp)
    planned = _path(cell, nominal, streams.motion, program)
    own = draw_errors(streams.arm, nominal, cell.errors)
    actual = kinematics.with_placement_errors(nominal, own.placement)
    gravity, earth = _site(cell, streams.site)
    sway, grade = draw_sway(streams.sway, cell.errors), GRADES[cell.imu.grade]
    drawn, effects = draw_sensors(streams.sensor, cell.imu, grade), draw_effects(streams.effects, cell.imu, grade)
    device = _Device(
        drawn if cell.run == 0 else at_mean_temperature(drawn, effects, cell.imu, cell.seconds),
        effects,
        draw_slip(streams.slip, cell.imu, min(cell.seconds, planned.seconds)),
        RandomPhysics.of(cell.unlisted, streams.physics, partial(_jacobian, nominal)),
        _OwnClock.of(cell, streams.own_clock, unit),
        f"imu{unit}",
    )
    say("move the IMU", 0.2)
    mount, seconds = ElasticMount.draw(streams.mount, cell.imu), min(cell.seconds, planned.seconds)
    rigid = partial(_inertial_motion, cell, planned, actual, sway, gravity, earth)
    motion = mount.moved(rigid, partial(_attitude, cell, planned, actual), seconds)
    imu, change = _imu(cell, planned, motion, device, streams, path)
    say("report poses", 0.8)
    measure: Measure
    if isinstance(planned, FreePath):
        measure = partial(_seen_freely, planned)
    elif cell.reference.kind == "mocap":  # cameras observe the tool itself, not the motors
        faultless = draw_errors(np.random.default_rng(0), actual, Errors.none())
        measure = partial(_seen, actual, planned, sway, faultless, Errors.none())
    else:
        measure = partial(measured, nominal, planned, own=own, errors=cell.errors)
    draws = ReferenceDraws(streams.path, streams.jitter, streams.clock, streams.reference)
    r = cell.reference
    reference, joints = report_poses(cell, planned, measure, draws, path, device.physics)
    reference = with_heading(reference, r.position_heading_deg * DEG, gravity)
    offset, skew = device.clock.against(int(reference.stamps_ns[0]), r.clock_offset, r.clock_drift_ppm * 1e-6)
    truth = Truth(
        device.sensors, offset, skew, gravity, earth, own, actual,
        device.effects, change, device.slip, r.position_scale_ppm * 1e-6, r.position_heading_deg * DEG, r.smoothing,
        mount,
    )  # fmt: skip
    return truth, as_stated(cell, nominal, Recording(path, imu, reference, joints))


def _jacobian(arm: Arm, angles: Array) -> Array:
    """Return the change of the tool's pose for a unit of each joint's angle, (n, 6, joints)."""
    return kinematics.derivatives(arm, angles).jacobian


def _path(cell: Cell, arm: Arm, rng: np.random.Generator, program: Program | None) -> Plan | FreePath:
    """Return the motion of the arm, or of a body that moves without one."""
    kind = cell.motion.kind
    if kind == "arm":
        return _plan(cell, arm, rng, program)
    if cell.reference.kind != "mocap":
        raise SettingsError(f'motion.kind = "{kind}" has no arm: set reference.kind = "mocap"')
    return free_path(rng, kind, cell.seconds, cell.motion.first_rest, cell.motion.range_share / 0.7)


def _seen_freely(planned: FreePath, t: Array) -> Report:
    """Return what cameras see of a body without an arm at times (n,)."""
    moved = planned.at(t)
    return moved.positions, moved.quaternions, np.zeros((t.size, 0))


def _seen(actual: Arm, planned: Plan, sway: Sway, own: ArmErrors, errors: Errors, t: Array) -> Report:
    """Return what cameras see of the tool at times (n,), where the base sways too."""
    p, q, angles = measured(actual, planned, t, own, errors)
    return p + sway.at(planned, t)[0], q, angles


def _plan(cell: Cell, arm: Arm, rng: np.random.Generator, program: Program | None) -> Plan:
    motion = cell.motion
    limits = Limits.of(arm, motion.tool_speed, motion.tool_acceleration)
    if program is not None:
        limits = replace(limits, straight=True)
    elif motion.program is not None:
        program = read_program(Path(motion.program), arm)
    if program is not None:
        return plan(arm, program.start, motion.first_rest, program.moves, limits, motion.smoothing)
    return random_plan(
        rng, _held_but(arm, motion.joints), limits, cell.seconds,
        rest=motion.rest, first_rest=motion.first_rest, range_share=motion.range_share, smoothing=motion.smoothing,
    )  # fmt: skip


def _held_but(arm: Arm, joints: tuple[int, ...]) -> Arm:
    """Return an arm of which only these joints (from 1) have a range to move in; all if none is named."""
    if not joints:
        return arm
    if not all(1 <= joint <= len(arm.joints) for joint in joints):
        raise SettingsError(f"motion.joints = {list(joints)}: {arm.name} has joints 1 to {len(arm.joints)}")
    moving, start = np.isin(np.arange(len(arm.joints)) + 1, joints), home(arm)
    return replace(arm, lower=np.where(moving, arm.lower, start), upper=np.where(moving, arm.upper, start))


def _site(cell: Cell, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return gravity and Earth rate in the base's frame."""
    latitude, heading = cell.site.latitude_deg * DEG, cell.site.heading_deg * DEG
    # base: x along the heading, z up
    c, s = np.cos(heading), np.sin(heading)
    C_rn = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    q_rn = multiply(from_matrix(C_rn), exp(cell.site.tilt_sd * rng.normal(size=3)))
    down = np.array([0.0, 0.0, normal_gravity(latitude, cell.site.height_m) + cell.site.gravity_anomaly])
    return apply(q_rn, down), apply(q_rn, earth_rate_n(latitude))


@dataclass(frozen=True)
class _Device:
    """One device, and what happens to it in a recording."""

    sensors: SensorParameters
    effects: DeviceEffects
    slip: Slip | None
    physics: RandomPhysics
    clock: _OwnClock
    name: str


@dataclass(frozen=True)
class _OwnClock:
    """The clock of a further IMU: its stamps of the times t since the first sample of the first IMU.

    Attributes
    ----------
    offset, drift
        s and 1.
    phase
        Share of a sampling interval by which it samples later.
    """

    offset: float = 0.0
    drift: float = 0.0
    phase: float = 0.0

    @classmethod
    def of(cls, cell: Cell, rng: np.random.Generator, unit: int) -> _OwnClock:
        if unit == 0:
            return cls()
        offset, drift = rng.normal(size=2) * [cell.tray.clock_offset, 1e-6 * cell.tray.clock_drift_ppm]
        return cls(float(offset), float(drift), float(rng.uniform()) if offset or drift else 0.0)

    def stamped(self, t: Array) -> Array:
        """Return what it shows at times t (n,), s."""
        return np.asarray(t + (self.offset + self.drift * t))

    def against(self, first_pose_ns: int, offset: float, skew: float) -> tuple[float, float]:
        """Return offset and drift against the reference's clock, from those of the first IMU's."""
        at = 1e-9 * (first_pose_ns - START_NS) + offset
        return float(self.stamped(np.array([at]))[0] - at + offset), skew + self.drift * (1.0 + skew)


def _cell_of(cell: Cell, unit: int) -> Cell:
    """Return the cell with the place of one of the IMUs on its tool."""
    tray = cell.tray
    still = {"slip_deg": 0.0} if tray.slipping not in (None, unit) else {}
    if unit == 0:
        return cell.model_copy(update={"imu": cell.imu.model_copy(update=still)})
    width = int(np.ceil(np.sqrt(tray.units)))
    place = np.array(cell.imu.lever_arm) + tray.spacing * np.array([unit % width, unit // width, 0.0])
    mount = exp(DEG * np.array(cell.imu.mounting_deg))
    if unit % 2:
        mount = multiply(mount, exp(DEG * np.array(tray.turned_deg)))
    own = {"lever_arm": tuple(place), "mounting_deg": tuple(log(mount) / DEG)} | still
    return cell.model_copy(update={"imu": cell.imu.model_copy(update=own)})


def _imu(
    cell: Cell, planned: Timeline, motion: Callable[[Array], _Inertial], device: _Device, streams: _Streams, path: Path
) -> tuple[ImuSamples, OffsetChange]:
    """Return the readings, and how the offsets changed."""
    grade = GRADES[cell.imu.grade]
    rate = cell.imu.rate or grade.rate
    n = round(min(cell.seconds, planned.seconds) * rate) + 1
    t = np.asarray((np.arange(n) + device.clock.phase) / rate, dtype=float)
    shake = vibration(streams.vibration, cell.imu, planned, t)
    temperature = temperature_of(cell.imu, t)
    temperature_difference = None if temperature is None else temperature - temperature.mean()
    rates, accelerations = device.effects.seen(
        lambda late: _ideal(motion(t - late), shake, device, t, temperature_difference)
    )
    unlisted = device.physics.readings(grade, t, rates, accelerations)
    rates, accelerations = rates + unlisted[0], accelerations + unlisted[1]
    drift = offset_drift(streams.drift, cell.imu, t)
    noises = draw_noise(streams.imu, cell.imu, grade, n, rate)
    readings = disturbed(cell.imu, grade, rate, (rates, accelerations), drift, noises)
    readings = with_faults(streams.faults, cell.imu, *readings)
    r = cell.reference
    own_clock = t + 1e-6 * r.clock_drift_ppm * (t - MARGIN) if r.clock_is_true else t
    stamps = START_NS + np.round(device.clock.stamped(own_clock) * 1e9).astype(np.int64)
    keep: Mask = streams.imu.uniform(size=n) >= cell.imu.drop_share
    keep &= ~_in_gap(streams.faults.spawn(1)[0], cell.imu.gap, t)
    keep[[0, -1]] = True
    samples = ImuSamples(
        stamped(cell.imu, streams.stamps, stamps, keep),
        readings[0][keep], readings[1][keep], path / device.name / "data.csv",
        temperature=None if temperature is None else temperature[keep],
    )  # fmt: skip
    return samples, offset_change(drift, (noises[0].slow, noises[1].slow))


def _in_gap(rng: np.random.Generator, gap: float, t: Array) -> Mask:
    """Return which samples (n,) fall into the one gap."""
    begin = middle(rng, float(t[-1])) - 0.5 * gap
    return np.asarray((t >= begin) & (t < begin + gap))


def _inertial_motion(
    cell: Cell, planned: Plan | FreePath, actual: Arm, sway: Sway, gravity: Array, earth: Array, t: Array
) -> _Inertial:
    """Return inertial rate, its derivative and specific force (n, 3) of the tool, in b, at times (n,)."""
    tool = _tool(cell, planned, actual, t)
    _, velocity, acceleration = sway.at(planned, t)
    back = conjugate(tool.quaternions)
    earth_b = apply(back, np.broadcast_to(earth, tool.rates.shape))
    omega = tool.rates + earth_b
    alpha = tool.angular_accelerations - np.cross(tool.rates, earth_b)
    accelerations = tool.accelerations + acceleration
    force = apply(back, accelerations - gravity + 2.0 * np.cross(earth, tool.velocities + velocity))
    return omega, alpha, force


def _tool(cell: Cell, planned: Plan | FreePath, actual: Arm, t: Array) -> kinematics.ToolMotion:
    """Return the motion of the tool in the base's frame at times (n,)."""
    if isinstance(planned, FreePath):
        return planned.at(t)
    motor, elastic = planned.at(t), swing(planned, t, cell.errors)
    return kinematics.motion(actual, *(a + b for a, b in zip(motor, elastic, strict=True)))


def _attitude(cell: Cell, planned: Plan | FreePath, actual: Arm, t: Array) -> Array:
    """Return the attitude of the tool (n, 4) in the base's frame at times (n,)."""
    return _tool(cell, planned, actual, t).quaternions


def _ideal(
    motion: _Inertial, shake: tuple[Array, Array], device: _Device, t: Array, temperature_difference: Array | None
) -> tuple[Array, Array]:
    """Return the readings without noise (n, 3), before and after the device slips."""
    omega, alpha, force = motion
    moved = (omega + shake[0], alpha, force + shake[1])
    rates, accelerations = ideal_readings(*moved, device.sensors, device.effects, temperature_difference)
    if device.slip is not None:
        late = (t >= device.slip.time)[:, None]
        later = ideal_readings(*moved, device.slip.after(device.sensors), device.effects, temperature_difference)
        rates, accelerations = np.where(late, later[0], rates), np.where(late, later[1], accelerations)
    return rates, accelerations


def write_truth(truth: Truth, file: Path) -> None:
    """Write the true values next to a recording; no estimator reads them."""
    s, effects, change = truth.sensors, truth.effects, truth.offset_change
    gyroscope: dict[str, Any] = {
        "cross_coupling": s.K_omega.tolist(),
        "offset": s.k_w[0].tolist(),
        "g_sensitivity": effects.g_sensitivity.tolist(),
        "g_squared": effects.g_squared.tolist(),
        "asymmetry": effects.gyro_asymmetry.tolist(),
        "axis_delay": effects.axis_delay.tolist(),
        "axis_smoothing": effects.axis_smoothing.tolist(),
        "temperature": effects.temperature[0].tolist(),
        "scale_temperature": effects.temperature[1].tolist(),
    }
    accelerometer: dict[str, Any] = {
        "cross_coupling": s.K_a.tolist(),
        "offset": s.k_a[0].tolist(),
        "lever_arms": s.lever_arms.tolist(),
        "asymmetry": effects.accel_asymmetry.tolist(),
        "delay": effects.accel_delay,
        "smoothing": float(effects.axis_smoothing.mean()),
        "axis_delay": effects.axis_delay.tolist(),
        "axis_smoothing": (effects.axis_smoothing - effects.axis_smoothing.mean()).tolist(),
        "temperature": effects.temperature[2].tolist(),
        "scale_temperature": effects.temperature[3].tolist(),
    }
    if change is not None:
        gyroscope["offset_change"] = {"mean": change.gyro_mean.tolist(), "end": change.gyro_end.tolist()}
        accelerometer["offset_change"] = {"mean": change.accel_mean.tolist(), "end": change.accel_end.tolist()}
    if s.k_w.shape[0] > 1:
        gyroscope["polynomial"], accelerometer["polynomial"] = {"2": s.k_w[1].tolist()}, {"2": s.k_a[1].tolist()}
    document: dict[str, Any] = {
        "gyroscope": gyroscope,
        "accelerometer": accelerometer,
        "time_offset": truth.time_offset,
        "time_skew": truth.time_skew,
        "gravity_in_base": truth.gravity_r.tolist(),
        "earth_rate_in_base": truth.earth_rate_r.tolist(),
        "reference": {
            "position_scale": truth.position_scale,
            "position_heading": truth.position_heading,
            "smoothing": truth.reference_smoothing,
            "mount_bending": truth.mount.bending.tolist(),
            "mount_deflection": truth.mount.deflection.tolist(),
        },
        "robot": {
            "placement_error": truth.arm.placement.tolist(),
            "gear_eccentricity": truth.arm.eccentricity.tolist(),
            "gear_phase": truth.arm.phase.tolist(),
            "compliance": truth.arm.compliance.tolist(),
            "lag": truth.arm.lag.tolist(),
            "backlash": truth.arm.backlash.tolist(),
            "zeros": truth.arm.zeros.tolist(),
        },
    }
    if truth.slip is not None:
        document["slip"] = {"turn": truth.slip.turn.tolist(), "time": truth.slip.time}
    file.write_text(json.dumps(document, indent=1), encoding="utf-8")

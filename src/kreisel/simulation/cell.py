"""The virtual cell: an arm moves an IMU, its controller reports poses, and all true values are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.geometry.rotation import Array, apply, conjugate, exp, from_matrix, multiply
from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.inertial.noise import GRADES
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses
from kreisel.recording.settings import ImuTable, RecordingSettings, ReferenceTable, RobotTable, SiteTable
from kreisel.robot import kinematics
from kreisel.robot.excitation import random_plan
from kreisel.robot.kinematics import Arm, load_arm
from kreisel.robot.motion import Limits, Plan, plan
from kreisel.robot.program import read_program
from kreisel.simulation.imu import disturbed, draw_sensors, ideal_readings
from kreisel.simulation.robot import ArmErrors, draw_errors, reported, swing
from kreisel.simulation.settings import Cell, Errors
from kreisel.units import DEG

_START_NS = 1_000_000_000_000
_MARGIN = 0.06
"""Seconds of IMU readings before the first pose and after the last."""

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
    """

    sensors: SensorParameters
    time_offset: float
    time_skew: float
    gravity_r: Array
    earth_rate_r: Array
    arm: ArmErrors
    actual: Arm


def simulate(
    cell: Cell, path: Path, progress: Progress | None = None, trial: int | None = None
) -> tuple[Truth, Recording]:
    """Return the recording of a virtual cell, and its true values; nothing is written.

    Parameters
    ----------
    path
        The recording's name.
    trial
        Number of a trial of a study: its random numbers come from that child of the cell's seed.

    Raises
    ------
    RobotError
        If the arm, or a pose of the program, is not possible.
    """
    # Independent random streams: switching one error on does not change the others.
    root = np.random.SeedSequence(cell.seed, spawn_key=() if trial is None else (trial,))
    streams = [np.random.default_rng(child) for child in root.spawn(7)]
    motion_rng, sensor_rng, imu_rng, arm_rng, path_rng, site_rng, jitter_rng = streams
    say = progress or (lambda _step, _share: None)
    say("plan motion", 0.0)
    nominal = load_arm(cell.robot.model, cell.robot.tcp)
    planned = _plan(cell, nominal, motion_rng)
    own = draw_errors(arm_rng, nominal, cell.errors)
    actual = kinematics.with_placement_errors(nominal, own.placement)
    gravity, earth = _site(cell, site_rng)
    sensors = draw_sensors(sensor_rng, cell.imu, GRADES[cell.imu.grade])
    say("move the IMU", 0.2)
    imu = _imu(cell, planned, actual, sensors, gravity, earth, imu_rng, path)
    say("report poses", 0.8)
    if cell.reference.kind == "mocap":  # cameras observe the tool itself, not the motors
        seen, faultless = actual, draw_errors(np.random.default_rng(0), actual, Errors.none())
    else:
        seen, faultless = nominal, own
    reference, joints = _reference(cell, planned, seen, faultless, path_rng, jitter_rng, path)
    truth = Truth(
        sensors, cell.reference.clock_offset, cell.reference.clock_drift_ppm * 1e-6, gravity, earth, own, actual
    )
    settings = recording_settings(cell, nominal)
    urdf = nominal.urdf if joints is not None else None
    return truth, Recording(path, imu, reference, joints, settings, urdf=urdf)


def _plan(cell: Cell, arm: Arm, rng: np.random.Generator) -> Plan:
    motion = cell.motion
    limits = Limits.of(arm, motion.tool_speed, motion.tool_acceleration)
    if motion.program is not None:
        program = read_program(Path(motion.program), arm)
        return plan(arm, program.start, motion.first_rest, program.moves, limits, motion.smoothing)
    return random_plan(
        rng, arm, limits, cell.seconds,
        rest=motion.rest, first_rest=motion.first_rest, range_share=motion.range_share, smoothing=motion.smoothing,
    )  # fmt: skip


def _site(cell: Cell, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return gravity and Earth rate in the base's frame."""
    latitude, heading = cell.site.latitude_deg * DEG, cell.site.heading_deg * DEG
    # base: x along the heading, z up
    c, s = np.cos(heading), np.sin(heading)
    C_rn = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    q_rn = multiply(from_matrix(C_rn), exp(cell.site.tilt_sd * rng.normal(size=3)))
    down = np.array([0.0, 0.0, normal_gravity(latitude, cell.site.height_m)])
    return apply(q_rn, down), apply(q_rn, earth_rate_n(latitude))


def _imu(
    cell: Cell,
    planned: Plan,
    actual: Arm,
    sensors: SensorParameters,
    gravity: Array,
    earth: Array,
    rng: np.random.Generator,
    path: Path,
) -> ImuSamples:
    grade = GRADES[cell.imu.grade]
    rate = cell.imu.rate or grade.rate
    n = round(min(cell.seconds, planned.seconds) * rate) + 1
    t = np.arange(n) / rate
    motor = planned.at(t)
    elastic = swing(planned, t, cell.errors)
    tool = kinematics.motion(actual, *(a + b for a, b in zip(motor, elastic, strict=True)))
    back = conjugate(tool.quaternions)
    earth_b = apply(back, np.broadcast_to(earth, tool.rates.shape))
    omega = tool.rates + earth_b
    alpha = tool.angular_accelerations - np.cross(tool.rates, earth_b)
    force = apply(back, tool.accelerations - gravity + 2.0 * np.cross(earth, tool.velocities))
    readings = disturbed(rng, cell.imu, grade, rate, *ideal_readings(omega, alpha, force, sensors), force)
    stamps = _START_NS + np.round(t * 1e9).astype(np.int64)
    keep = rng.uniform(size=n) >= cell.imu.drop_share
    keep[[0, -1]] = True
    return ImuSamples(stamps[keep], readings[0][keep], readings[1][keep], path / "imu0" / "data.csv")


def _reference(
    cell: Cell,
    planned: Plan,
    nominal: Arm,
    own: ArmErrors,
    rng: np.random.Generator,
    jitter_rng: np.random.Generator,
    path: Path,
) -> tuple[ReferencePoses, JointAngles | None]:
    """Return poses and joint angles on the reference's own clock."""
    r = cell.reference
    skew = r.clock_drift_ppm * 1e-6
    last = min(cell.seconds, planned.seconds)
    tau = np.arange(0.0, (last - 2.0 * _MARGIN) / (1.0 + skew), r.interval)
    kept = jitter_rng.uniform(size=tau.size) >= r.drop_share
    kept[[0, -1]] = True
    tau = tau[kept]
    t = _MARGIN + (1.0 + skew) * tau
    jitter = r.jitter * jitter_rng.normal(size=t.size)
    p, q, angles = reported(rng, nominal, planned, t, jitter, own, cell.errors)
    stamps = _START_NS + np.round((tau + _MARGIN - r.clock_offset) * 1e9).astype(np.int64)
    name = "pose0"
    reference = ReferencePoses(
        name,
        stamps,
        p if r.measures != "orientation" else None,
        q if r.measures != "position" else None,
        path / name / "data.csv",
    )
    with_joints = r.joints and r.kind == "robot"
    joints = JointAngles(stamps, angles, path / "joint0" / "data.csv") if with_joints else None
    return reference, joints


def recording_settings(cell: Cell, arm: Arm) -> RecordingSettings:
    """Return what the cell's owner would write into recording.toml."""
    errors, r = cell.errors, cell.reference

    def sd(value: float) -> float:
        return max(float(value), 1e-7)

    robot = RobotTable()
    if r.kind == "robot":
        robot = RobotTable(
            urdf="robot.urdf" if r.joints else None,
            tcp=arm.tcp if r.joints else None,
            length_sd=errors.geometry_length_sd,
            angle_sd=errors.geometry_angle_sd,
        )
    grade = GRADES[cell.imu.grade]
    return RecordingSettings(
        imu=ImuTable(grade=cell.imu.grade)
        if cell.imu.noise
        else ImuTable(
            gyro_noise_density=1e-7,
            accel_noise_density=1e-5,
            gyro_offset_sd=grade.gyro_offset_sd,
            accel_offset_sd=grade.accel_offset_sd,
        ),
        site=SiteTable(latitude_deg=cell.site.latitude_deg, height_m=cell.site.height_m),
        reference=ReferenceTable(
            kind=r.kind,
            # between two rests the error passes from that of the first to that of the second
            position_sd=sd(np.hypot(errors.path_position_sd, errors.repeatability_position_sd)),
            orientation_sd=sd(np.hypot(errors.path_orientation_sd, errors.repeatability_orientation_sd)),
            standstill_position_sd=sd(errors.repeatability_position_sd),
            standstill_orientation_sd=sd(errors.repeatability_orientation_sd),
        ),
        robot=robot,
    )


def write_truth(truth: Truth, file: Path) -> None:
    """Write the true values next to a recording; no estimator reads them."""
    s = truth.sensors
    document: dict[str, Any] = {
        "gyroscope": {"cross_coupling": s.K_omega.tolist(), "offset": s.k_w[0].tolist()},
        "accelerometer": {
            "cross_coupling": s.K_a.tolist(),
            "offset": s.k_a[0].tolist(),
            "lever_arms": s.lever_arms.tolist(),
        },
        "time_offset": truth.time_offset,
        "time_skew": truth.time_skew,
        "gravity_in_base": truth.gravity_r.tolist(),
        "earth_rate_in_base": truth.earth_rate_r.tolist(),
        "robot": {
            "placement_error": truth.arm.placement.tolist(),
            "gear_eccentricity": truth.arm.eccentricity.tolist(),
            "gear_phase": truth.arm.phase.tolist(),
            "compliance": truth.arm.compliance.tolist(),
            "lag": truth.arm.lag.tolist(),
        },
    }
    if s.k_w.shape[0] > 1:
        document["gyroscope"]["polynomial"] = {"2": s.k_w[1].tolist()}
        document["accelerometer"]["polynomial"] = {"2": s.k_a[1].tolist()}
    file.write_text(json.dumps(document, indent=1), encoding="utf-8")

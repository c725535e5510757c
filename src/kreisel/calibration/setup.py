"""From a recording to a problem: clocks, first values, noise, schedule."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from kreisel.calibration.initial import (
    Accelerations,
    ForceFit,
    alignment_from_gravity,
    attitude_from_positions,
    fit_forces,
    reference_attitude,
)
from kreisel.calibration.parameters import GROUPS, ROBOT_GROUPS, CellParameters, RobotParameters
from kreisel.calibration.problem import Problem, Site, build_layout, schedule
from kreisel.calibration.reference_noise import ReferenceNoise, believed_noise, with_measured_jitter
from kreisel.calibration.rests import OutsideRest, Rest, find_rests, imu_still, rest_outside
from kreisel.calibration.robot_errors import RobotModel, robot_model
from kreisel.calibration.settings import CalibrationSettings
from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, Indices, nearest_rotation, skew
from kreisel.inertial.earth import earth_rate_n, normal_gravity
from kreisel.inertial.noise import GRADES, Grade, equivalent_walk, high_frequency_density
from kreisel.inertial.readings import Readings
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.inertial.strapdown import InertialSignal
from kreisel.recording import Finding, ImuSamples, Recording, ReferencePoses
from kreisel.recording.checks import LONG_GAP, gaps
from kreisel.recording.recording import excerpt
from kreisel.synchronization import Clock, Correlation, RateFit, check_conventions, correlate, fit_rates
from kreisel.synchronization.correlation import LARGEST_SKEW, quietest_second
from kreisel.units import DEG, STANDARD_GRAVITY

INTERVALS = {"robot": 0.48, "mocap": 0.24}
"""Seconds between updates. The paper's 0.48 s suit a robot whose errors stay alike over tenths of a
second; motion capture errs nearly independently from frame to frame, and hands move less smoothly."""

_DOUBT = 20.0
_NORTH_SD = 0.7
_CROSS_COUPLING_SD = 0.05
_NON_ORTHOGONALITY = 0.015
_BENT_GYRO, _BENT_ACCEL, _BENT_CROSS_COUPLING = 0.01, 0.3, 0.02
_LEAST_NOISE, _MOTION_NOISE = 0.7, 20.0
_HALF_A_CHAIN = math.sqrt(2.0)
_LEAST_POSES = 10

GRAVITY_SD = 0.015
"""m/s^2; spread of gravity over the inhabited Earth about standard gravity."""


@dataclass(frozen=True)
class ImuNoise:
    """Noise of the IMU, SI: densities (3,), random walks and prior deviations of its offsets.

    `gyro_bounds` and `accel_bounds` hold the densities the data may move it between: from what the maker
    says to well above what the readings' own scatter shows, for errors that grow with the motion.
    """

    gyro: Array
    accel: Array
    gyro_bounds: tuple[float, float]
    accel_bounds: tuple[float, float]
    gyro_walk: float
    accel_walk: float
    given: bool
    gyro_offset_sd: float | None
    accel_offset_sd: float | None


@dataclass(frozen=True)
class Preparation:
    """All that comes before the filter."""

    recording: Recording
    reference: ReferencePoses
    site: Site
    imu_noise: ImuNoise
    noise: ReferenceNoise
    readings: Readings
    correlation: Correlation
    rate_fit: RateFit
    force_fit: ForceFit
    rests: tuple[Rest, ...]
    outside_rest: OutsideRest | None
    robot: RobotModel | None
    findings: tuple[Finding, ...]


def site_of(recording: Recording) -> Site:
    """Return gravity and Earth rate where the recording was made, as far as its settings tell."""
    table = recording.settings.site
    rate = None if table.latitude_deg is None else earth_rate_n(math.radians(table.latitude_deg))
    if table.gravity is not None:
        return Site(table.gravity, 0.0, rate)
    if table.latitude_deg is not None:
        return Site(normal_gravity(math.radians(table.latitude_deg), table.height_m or 0.0), 0.0, rate)
    return Site(STANDARD_GRAVITY, GRAVITY_SD, None)


def imu_noise_of(recording: Recording) -> ImuNoise:
    """Return the IMU's noise: as given, by grade, or as it shows in the readings."""
    table, imu, sheet = recording.settings.imu, recording.imu, recording.datasheet
    grade = GRADES.get(table.grade or "")
    gyro = table.gyro_noise_density or (grade.gyro_noise_density if grade else None)
    accel = table.accel_noise_density or (grade.accel_noise_density if grade else None)
    if sheet is not None and gyro is None and accel is None:
        gyro, accel = sheet.gyro_noise_density, sheet.accel_noise_density
    shown_gyro, shown_accel = (
        np.maximum(np.median([high_frequency_density(p, imu.interval) for p in excerpt(values)], axis=0), least)
        for values, least in ((imu.rates, 1e-7), (imu.accelerations, 1e-6))
    )
    given = table.gyro_noise_density is not None or grade is not None
    return ImuNoise(
        gyro=np.full(3, gyro) if gyro and given else np.maximum(shown_gyro, gyro or 0.0),
        accel=np.full(3, accel) if accel and given else np.maximum(shown_accel, accel or 0.0),
        gyro_bounds=_bounds(gyro, shown_gyro),
        accel_bounds=_bounds(accel, shown_accel),
        gyro_walk=_walk(None if sheet is None else sheet.gyro_random_walk, grade, "gyro"),
        accel_walk=_walk(None if sheet is None else sheet.accel_random_walk, grade, "accel"),
        given=given,
        gyro_offset_sd=table.gyro_offset_sd or (grade.gyro_offset_sd if grade else None),
        accel_offset_sd=table.accel_offset_sd or (grade.accel_offset_sd if grade else None),
    )


def _walk(stated: float | None, grade: Grade | None, sensor: Literal["gyro", "accel"]) -> float:
    """Return the density of the offset's random walk: as stated, by grade, or none."""
    if stated is not None:
        return stated
    if grade is None:
        return 0.0
    if sensor == "gyro":
        return equivalent_walk(grade.gyro_bias_instability, grade.gyro_rate_random_walk)
    return equivalent_walk(grade.accel_bias_instability, grade.accel_random_walk)


def _bounds(stated: float | None, shown: Array) -> tuple[float, float]:
    size = float(np.sqrt(np.mean(shown**2)))
    low = stated or _LEAST_NOISE * size
    return low, max(low, _MOTION_NOISE * size)


def readings_of(recording: Recording, noise: ImuNoise, order: int) -> Readings:
    """Return the IMU's readings, split at long gaps, with their noise."""
    imu = recording.imu
    cuts = gaps(imu.stamps_ns, LONG_GAP)
    edges = [0, *(int(k) + 1 for k in cuts), imu.stamps_ns.size]
    segments = tuple((a, b - 1) for a, b in pairwise(edges) if b - a >= 20)
    if not segments:
        raise RecordingError("no unbroken stretch of 20 samples or more", file=imu.source)
    bends = [_usual_bend(imu, values) for values in (imu.rates, imu.accelerations)]
    return Readings(
        imu.seconds, imu.rates, imu.accelerations, segments, order, np.array([noise.gyro**2, noise.accel**2, *bends])
    )


def _usual_bend(imu: ImuSamples, values: Array) -> Array:
    """Return the size of the second derivative the readings usually have, (3,)."""
    size = [np.percentile(np.abs(np.diff(part, n=2, axis=0)), 90, axis=0) for part in excerpt(values)]
    return np.asarray(np.median(size, axis=0) / imu.interval**2)


def pose_indices(rests: tuple[Rest, ...], t_pose: Array) -> list[Indices]:
    """Return the indices of the poses in each rest."""
    return [np.flatnonzero((t_pose >= rest.start) & (t_pose <= rest.stop)) for rest in rests]


def prepare_recording(recording: Recording, settings: CalibrationSettings) -> Preparation:
    """Return clocks, first values and noise of a recording.

    Raises
    ------
    SynchronizationError, RecordingError
        If reference and IMU do not belong together, or there is no reference.
    """
    reference = recording.reference
    if reference is None:
        raise RecordingError(
            "has no reference poses; `kreisel calibrate` needs pose0/data.csv or another reference beside imu0",
            file=recording.path,
        )
    findings: list[Finding] = []
    imu_noise = imu_noise_of(recording)
    readings = readings_of(recording, imu_noise, settings.polynomial_order)
    correlation = correlate(recording.imu, reference)
    check_conventions(readings, reference, correlation.clock)
    tau = reference.seconds
    if reference.quaternions is not None:
        fit = fit_rates(readings, tau, reference.quaternions, correlation.clock)
    else:
        fit = _rates_without_attitude(recording.imu, reference, correlation.clock)
        findings.append(Finding("reference", "positions only: b takes the gyros' axes, as far as they are square"))
    if reference.positions is None:
        findings.append(Finding("reference", "orientations only: accelerometers are seen at rests, and between them"))
    findings += _overlap_finding(recording.imu, reference, fit.clock)
    site = site_of(recording)
    noise = believed_noise(recording.settings, reference)
    standstill = imu_still(recording.imu)
    rests = find_rests(standstill, reference, fit.clock, noise.position, noise.orientation)
    stretches = [(rest.start, rest.stop) for rest in rests]
    force = _forces(readings, fit, reference, site.gravity, stretches)
    noise = with_measured_jitter(noise, reference, pose_indices(rests, fit.clock.imu_time(tau)))
    outside = rest_outside(recording.imu, standstill, reference, fit.clock)
    if outside is not None:
        findings.append(
            Finding("rest", f"{outside.seconds:.1f} s of rest without reference used for the gyro offset's first value")
        )
    if noise.stamp > 0.0:
        findings.append(
            Finding(
                "stamps",
                f"the reference's stamps are rounded to {noise.stamp * 12**0.5 * 1e3:.0f} ms; "
                "taken as noise along the motion",
            )
        )
    robot, said = (None, []) if "robot_placement" in settings.fixed else robot_model(recording, reference)
    findings += said
    return Preparation(
        recording, reference, site, imu_noise, noise, readings, correlation, fit, force, rests, outside, robot,
        tuple(findings),
    )  # fmt: skip


def _overlap_finding(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> list[Finding]:
    """Return what to say where the two have little time in common, as where one began late or its clock leapt."""
    first, last = clock.imu_time(reference.seconds[[0, -1]])
    end = float(imu.seconds[-1])
    common, shorter = min(float(last), end) - max(float(first), 0.0), min(float(last - first), end)
    if common > 0.7 * shorter:
        return []
    said = f"IMU and reference have {common:.1f} s in common, of {end:.1f} s and {last - first:.1f} s; no more is used"
    return [Finding("overlap", said)]


def _forces(
    readings: Readings, fit: RateFit, reference: ReferencePoses, gravity: float, rests: list[tuple[float, float]]
) -> ForceFit:
    """Return the first values of the accelerometers."""
    blind = reference.positions is None
    if blind and reference.quaternions is None:
        raise RecordingError("holds neither positions nor orientations", file=reference.source)
    within = fit.clock.imu_time(reference.seconds[[0, -1]])
    force = None
    for _ in range(4 if reference.quaternions is None else 1):  # attitude and accelerometers need each other
        seen = [
            Accelerations.over(signal, fit, tau, q, p, rests)
            for signal, tau, p, q in _with_attitude(readings.excerpt(*within), fit, reference, force)
        ]
        if not seen:
            raise SynchronizationError(
                f"{reference.source}: too few poses where IMU and reference overlap; record both all the time"
            )
        force = fit_forces(Accelerations.joined(seen), fit, gravity, blind=blind)
    assert force is not None  # noqa: S101 - for the type checker; it went round once
    return force


def _with_attitude(
    stretches: Iterable[InertialSignal], fit: RateFit, reference: ReferencePoses, force: ForceFit | None
) -> Iterator[tuple[InertialSignal, Array, Array | None, Array]]:
    """Yield stretches of readings with reference seconds and positions in them, and attitudes at their samples."""
    tau = reference.seconds
    for signal in stretches:
        part = slice(*np.searchsorted(fit.clock.imu_time(tau), signal.stamps[[0, -1]]))
        if part.stop - part.start < _LEAST_POSES or not signal.segments:
            continue
        p = None if reference.positions is None else reference.positions[part]
        if reference.quaternions is not None:
            q = reference_attitude(signal, fit, tau[part], reference.quaternions[part])
        else:
            assert p is not None  # noqa: S101 - for the type checker; a reference has one of the two
            q = attitude_from_positions(signal, fit, tau[part], p, force)
        yield signal, tau[part], p, q


def _first_attitudes(preparation: Preparation, samples: Indices) -> Array:
    """Return the attitudes navigation begins with at samples, (k, 4), where the reference shows none."""
    out = np.tile([1.0, 0.0, 0.0, 0.0], (samples.size, 1))
    fit, reference, force = preparation.rate_fit, preparation.reference, preparation.force_fit
    if reference.quaternions is not None:
        return out
    for signal, _, _, q in _with_attitude(preparation.readings.stretches(), fit, reference, force):
        inside = (samples >= signal.begin) & (samples < signal.begin + signal.stamps.size)
        out[inside] = q[samples[inside] - signal.begin]
    return out


def _rates_without_attitude(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> RateFit:
    """Return what is known of the gyros without attitudes: their mean at the quietest moment."""
    still = quietest_second(imu)
    return RateFit(
        K_omega=np.eye(3),
        k_w0=-imu.rates[still].mean(axis=0),
        clock=clock,
        skewed=abs(clock.skew) > 4.0 * clock.skew_sd or clock.skew_sd * float(reference.seconds[-1]) > 5e-3,
        explained=float("nan"),
        residual_sd=float("nan"),
        K_omega_sd=np.full((3, 3), _CROSS_COUPLING_SD / _DOUBT),
        k_w0_sd=np.full(3, 1e-3),
    )


def first_values(preparation: Preparation, order: int) -> tuple[CellParameters, dict[str, Array]]:
    """Return the parameters the filter starts from, and the covariance of each group it believes in.

    The least squares fits are believed `_DOUBT` times less than they claim: enough to count the same data
    twice by a quarter of a per cent only, and near enough for the sigma points to stay where the model is
    nearly linear.
    """
    fit, force, noise, site = preparation.rate_fit, preparation.force_fit, preparation.imu_noise, preparation.site
    gyro_offset, gyro_offset_sd = _with_prior(fit.k_w0, fit.k_w0_sd, noise.gyro_offset_sd, 0.02)
    if preparation.outside_rest is not None:
        rest_sd = preparation.outside_rest.deviation(noise.gyro)
        better = rest_sd < gyro_offset_sd
        gyro_offset = np.where(better, -preparation.outside_rest.rate, gyro_offset)
        gyro_offset_sd = np.where(better, rest_sd, gyro_offset_sd)
    accel_offset, accel_offset_sd = _with_prior(force.k_a0, force.k_a0_sd, noise.accel_offset_sd, 0.6)
    # Accelerometers the motion hardly shows are believed to sit as the gyros do, within a few per cent.
    mount = _nominal(preparation, order).sensors.K_a
    K_a_sd = _DOUBT * force.K_a_sd
    K_a = np.where(K_a_sd < _CROSS_COUPLING_SD, force.K_a, mount)
    k_w, k_a = np.zeros((order, 3)), np.zeros((order, 3))
    k_w[0], k_a[0] = gyro_offset, accel_offset
    if order > 1:
        # the fits know no polynomials: what those add to the readings is an error of theirs
        gyro_offset_sd = np.maximum(gyro_offset_sd, np.minimum(noise.gyro_offset_sd or np.inf, _BENT_GYRO))
        accel_offset_sd = np.maximum(accel_offset_sd, np.minimum(noise.accel_offset_sd or np.inf, _BENT_ACCEL))
    least = 1e-3 if order == 1 else _BENT_CROSS_COUPLING
    turned = _turned_by_robot(preparation.robot)
    least = max(least, turned)
    K_omega, K_omega_covariance = _nearly_orthogonal(
        fit.K_omega, np.clip(_DOUBT * fit.K_omega_sd, least, _CROSS_COUPLING_SD)
    )
    if preparation.reference.quaternions is None:
        K_omega_covariance = _without_turn(K_omega_covariance)
    K_a, K_a_covariance = _nearly_orthogonal(K_a, np.clip(K_a_sd, least, _CROSS_COUPLING_SD))
    # without positions, what all three accelerometers are away from b shows nowhere
    arm = force.lever_arm if preparation.reference.positions is not None else np.zeros(3)
    sensors = SensorParameters(K_omega, k_w, K_a, k_a, np.tile(arm, (3, 1)))
    start = CellParameters(
        sensors, alignment_from_gravity(force.gravity), np.zeros(2), site.gravity, fit.clock.start, fit.clock.skew,
        RobotParameters.none(0 if preparation.robot is None else preparation.robot.joints),
    )  # fmt: skip
    tilt = float(np.clip(_DOUBT * force.tilt_sd, max(1e-4, turned), 0.05))
    deviation = {
        "gyro_offset": gyro_offset_sd,
        "gyro_polynomial": np.full(3 * (order - 1), 0.02),
        "accel_offset": accel_offset_sd,
        "accel_polynomial": np.full(3 * (order - 1), 0.005),
        "lever_arms": np.full(9, 0.1),
        "alignment": np.full(2, tilt),
        "north": np.full(2, _NORTH_SD),
        "gravity": np.array([max(site.gravity_sd, 1e-9)]),
        "time_offset": np.array([max(_DOUBT * fit.clock.start_sd, 1e-3)]),
        "time_skew": np.array([max(_DOUBT * fit.clock.skew_sd, 1e-6)]),
    }
    covariance = {group: np.diag(sd**2) for group, sd in deviation.items()}
    covariance |= {"gyro_cross_coupling": K_omega_covariance, "accel_cross_coupling": K_a_covariance}
    if preparation.robot is not None:
        covariance |= preparation.robot.covariance
    return start, covariance


def _turned_by_robot(robot: RobotModel | None) -> float:
    """Return how far a robot's errors may turn its tool, rad: the least squares fits take them for noise."""
    if robot is None:
        return 0.0
    angles = np.diag(robot.covariance["robot_placement"]).reshape(-1, 6)[:, 3:]
    return 2.0 * float(np.sqrt(angles.sum() / 3.0))


def _nearly_orthogonal(K: Array, deviation: Array) -> tuple[Array, Array]:
    """Return a cross-coupling matrix and its covariance (9, 9) once it is known that triads are nearly square.

    The mean of the two couplings between a pair of axes, seen along the mount, is their non-orthogonality:
    three observations of zero with the deviation `_NON_ORTHOGONALITY`. They matter only where the motion
    says less.

    Parameters
    ----------
    K, deviation : (3, 3)
        The matrix, and the standard deviations of its entries.
    """
    R = nearest_rotation(K)
    P = np.diag(deviation.ravel() ** 2)
    H = np.zeros((3, 9))
    for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        shear = 0.5 * (np.outer(R[:, i], np.eye(3)[j]) + np.outer(R[:, j], np.eye(3)[i]))
        H[row] = shear.ravel()
    S = H @ P @ H.T + _NON_ORTHOGONALITY**2 * np.eye(3)
    gain = np.linalg.solve(S, H @ P).T
    mean = K.ravel() - gain @ (H @ K.ravel())
    P = P - gain @ S @ gain.T
    return mean.reshape(3, 3), 0.5 * (P + P.T)


def _without_turn(P: Array) -> Array:
    """Return the covariance (9, 9) of a cross-coupling matrix near one once it is known not to turn b."""
    H = np.array([skew(e).ravel() for e in np.eye(3)]) / 2.0
    S = H @ P @ H.T + 1e-6**2 * np.eye(3)
    gain = np.linalg.solve(S, H @ P).T
    P = P - gain @ S @ gain.T
    return np.asarray(0.5 * (P + P.T) + 1e-18 * np.eye(9))


_WIDTH = {
    "gyro_cross_coupling": np.full(9, _CROSS_COUPLING_SD),
    "gyro_offset": np.full(3, 0.02),
    "gyro_polynomial": np.array([0.02]),
    "accel_cross_coupling": np.full(9, _CROSS_COUPLING_SD),
    "accel_offset": np.full(3, 0.6),
    "accel_polynomial": np.array([0.005]),
    "lever_arms": np.full(9, 0.1),
    "alignment": np.full(2, 0.05),
    "north": np.full(2, _NORTH_SD),
    "time_offset": np.array([0.01]),
    "time_skew": np.array([LARGEST_SKEW]),
}
"""Standard deviations of what an unknown IMU on an unknown mount may be, SI."""


def _nominal(preparation: Preparation, order: int) -> CellParameters:
    """Return the parameters of a faultless IMU on the mount found.

    A mount within three degrees of one along the axes is taken for that: brackets are built so.
    """
    R = nearest_rotation(preparation.rate_fit.K_omega)
    along = np.round(R)
    if (
        abs(np.linalg.det(along)) == 1.0
        and np.arccos(np.clip((np.trace(R.T @ along) - 1.0) / 2.0, -1.0, 1.0)) < 3.0 * DEG
    ):
        R = along
    ideal = SensorParameters.ideal(order)
    return CellParameters(
        replace(ideal, K_omega=R, K_a=R),
        alignment_from_gravity(preparation.force_fit.gravity),
        np.zeros(2),
        preparation.site.gravity,
        preparation.rate_fit.clock.start,
        preparation.rate_fit.clock.skew,
        RobotParameters.none(0 if preparation.robot is None else preparation.robot.joints),
    )


def _with_prior(value: Array, value_sd: Array, given_sd: float | None, widest: float) -> tuple[Array, Array]:
    """Return an offset and its deviation: what was given, centred at zero, or the fit where that says more."""
    doubtful = np.minimum(_DOUBT * value_sd, widest)
    if given_sd is None:
        return value, doubtful
    better = doubtful < given_sd
    return np.where(better, value, 0.0), np.where(better, doubtful, given_sd)


def _frame_doubt(preparation: Preparation) -> tuple[float, float]:
    """Return how far a robot's errors move base and tool, where they are stated but cannot be estimated."""
    table = preparation.recording.settings.robot
    if preparation.robot is not None:
        return (0.0, 0.0)
    # half of the chain's errors act like another base, half like another tool
    return (_HALF_A_CHAIN * (table.length_sd or 0.0), _HALF_A_CHAIN * (table.angle_sd or 0.0))


def _with_held_values(start: CellParameters, preparation: Preparation, settings: CalibrationSettings) -> CellParameters:
    """Return the first values with those the user holds groups at."""
    if not settings.held_at:
        return start
    stored = {group: start.stored(group) for group in GROUPS}
    for group in settings.fixed:
        value = settings.value_of(group)
        if value is not None:
            stored[group] = value
            if group == "time_offset":  # between stamps, as in the result; here between first IMU sample and first pose
                first = int(preparation.recording.imu.stamps_ns[0]), int(preparation.reference.stamps_ns[0])
                stored[group] = value - Clock(0.0).offset(*first)
    return CellParameters.from_stored(stored)


def build_problem(preparation: Preparation, settings: CalibrationSettings) -> Problem:
    """Return the problem for the filter.

    Raises
    ------
    SynchronizationError
        If too little of the reference lies within the IMU's recording.
    """
    fit, site, reference = preparation.rate_fit, preparation.site, preparation.reference
    start, covariance = first_values(preparation, settings.polynomial_order)
    skewed = fit.skewed if settings.skew is None else settings.skew
    if not skewed:
        start = replace(start, skew=0.0)
    start = _with_held_values(start, preparation, settings)
    kind = preparation.recording.settings.reference.kind or "robot"
    interval = settings.update_interval or INTERVALS[kind]
    tau = reference.seconds
    clock = Clock(start.start, start.skew)
    updates = schedule(preparation.readings, clock.imu_time(tau), tau, preparation.rests, interval)
    if len(updates) < 20:
        raise SynchronizationError(
            f"{reference.source}: only {len(updates)} updates of {interval:g} s lie within the IMU's recording; "
            "expected 20 or more: record longer, or use a shorter --update-interval"
        )
    noise = preparation.imu_noise
    given = {}
    if noise.gyro_offset_sd is not None:
        given["gyro_offset"] = np.full(3, noise.gyro_offset_sd)
    if noise.accel_offset_sd is not None:
        given["accel_offset"] = np.full(3, noise.accel_offset_sd)
    layout = build_layout(
        settings,
        north=site.earth_rate_n is not None,
        gravity=site.gravity_sd > 0.0,
        skew=skewed,
        rest_error=any(u.rest is not None for u in updates),
        joints=0 if preparation.robot is None else preparation.robot.joints,
    )
    return Problem(
        readings=preparation.readings,
        reference=reference,
        attitude=_first_attitudes(preparation, np.array([update.last for update in updates])),
        tau=tau,
        settings=settings,
        site=site,
        noise=preparation.noise,
        least_noise=(0.1 * preparation.noise.position, 0.1 * preparation.noise.orientation),
        imu_bounds=(preparation.imu_noise.gyro_bounds, preparation.imu_noise.accel_bounds),
        offset_walk={"gyro_offset": preparation.imu_noise.gyro_walk, "accel_offset": preparation.imu_noise.accel_walk},
        layout=layout,
        start=start,
        prior=start,
        prior_covariance={group: covariance[group] for group in GROUPS if group in layout},
        prior_width={
            **_WIDTH,
            **given,
            "gravity": np.array([max(site.gravity_sd, 1e-9)]),
            **{g: np.sqrt(np.diag(covariance[g])) for g in ROBOT_GROUPS if g in covariance},
        },
        given_priors=tuple(given),
        nominal=_nominal(preparation, settings.polynomial_order),
        rests=preparation.rests,
        updates=updates,
        update_interval=interval,
        robot=preparation.robot,
        frame_sd=_frame_doubt(preparation),
    )

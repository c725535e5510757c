"""From a recording to a problem: clocks, first values, noise, schedule."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from kreisel.calibration.initial import (
    Accelerations,
    ForceFit,
    attitude_from_positions,
    fit_forces,
    reference_attitude,
)
from kreisel.calibration.problem import Site
from kreisel.calibration.reference_noise import ReferenceNoise, believed_noise, with_measured_jitter
from kreisel.calibration.rests import OutsideRest, Rest, Standstill, find_rests, imu_still, rest_outside
from kreisel.calibration.robot_errors import RobotModel, robot_model
from kreisel.calibration.settings import CalibrationSettings
from kreisel.calibration.site import site_of
from kreisel.errors import RecordingError, SynchronizationError
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.noise import GRADES, Grade, equivalent_walk, high_frequency_density
from kreisel.inertial.readings import Readings
from kreisel.inertial.strapdown import InertialSignal
from kreisel.recording import Finding, ImuSamples, Recording, ReferencePoses
from kreisel.recording.checks import LONG_GAP, gaps
from kreisel.recording.recording import excerpt
from kreisel.synchronization import Clock, Correlation, RateFit, check_conventions, correlate, fit_rates
from kreisel.synchronization.correlation import quietest_second

_LEAST_NOISE, _MOTION_NOISE = 0.7, 20.0
_LEAST_POSES = 10


@dataclass(frozen=True)
class ImuNoise:
    """Noise of the IMU, SI: densities (3,), random walks and prior deviations of its offsets.

    `gyro_bounds` and `accel_bounds` hold the densities the data may move it between: from what the maker
    says to well above what the readings' own scatter shows, for errors that grow with the motion. `gyro_scatter` is
    the noise of a single reading, rad/s.
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
    gyro_scatter: float


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
    standstill: Standstill
    rests: tuple[Rest, ...]
    outside_rest: OutsideRest | None
    robot: RobotModel | None
    findings: tuple[Finding, ...]


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
        gyro_scatter=min(gyro or np.inf, float(np.sqrt(np.mean(shown_gyro**2)))) * imu.interval**-0.5,
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
    site, said = site_of(recording)
    findings += said
    noise = believed_noise(recording.settings, reference)
    standstill = imu_still(recording.imu)
    rests = find_rests(standstill, reference, fit.clock, noise)
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
        recording, reference, site, imu_noise, noise, readings, correlation, fit, force, standstill, rests, outside,
        robot, tuple(findings),
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


def first_attitudes(preparation: Preparation, samples: Indices) -> Array:
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
        K_omega_sd=np.full((3, 3), 0.0025),
        k_w0_sd=np.full(3, 1e-3),
    )

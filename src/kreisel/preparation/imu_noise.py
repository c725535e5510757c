"""The IMU's readings with their noise: as stated, by grade, or estimated from the readings."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.inertial.noise import (
    DRIFT_TIME,
    GRADES,
    Grade,
    coarse_step,
    drift_size,
    equivalent_walk,
    high_frequency_density,
)
from kreisel.inertial.readings import Readings
from kreisel.preparation.preparation import ImuNoise
from kreisel.recording.recording import ImuSamples, Recording, excerpt
from kreisel.recording.stamp_checks import LONG_GAP, gaps

_MIN_NOISE_SHARE, _MOTION_NOISE = 0.7, 20.0

_HIDDEN = 0.5
"""Density of slow noise, as a share of that of the white noise, below which its effect on deviations is small."""


def imu_noise_of(recording: Recording) -> ImuNoise:
    """Return the IMU's noise: as given, by grade, or estimated from the readings."""
    table, imu, sheet = recording.settings.imu, recording.imu, recording.datasheet
    grade = GRADES.get(table.grade or "")
    gyro = table.gyro_noise_density or (grade.gyro_noise_density if grade else None)
    accel = table.accel_noise_density or (grade.accel_noise_density if grade else None)
    if sheet is not None and gyro is None and accel is None:
        gyro, accel = sheet.gyro_noise_density, sheet.accel_noise_density
    observed_gyro, observed_accel = (
        np.maximum(np.median([high_frequency_density(p, imu.interval) for p in excerpt(values)], axis=0), least)
        for values, least in ((imu.rates, 1e-7), (imu.accelerations, 1e-6))
    )
    flickers = ((0.0, 0.0), (0.0, 0.0))
    if grade is not None:
        flickers = (
            (grade.gyro_bias_instability, grade.gyro_noise_density),
            (grade.accel_bias_instability, grade.accel_noise_density),
        )
    given = table.gyro_noise_density is not None or grade is not None
    accel_given = table.accel_noise_density is not None or grade is not None
    return ImuNoise(
        gyro=np.full(3, gyro) if gyro and given else np.maximum(observed_gyro, gyro or 0.0),
        accel=np.full(3, accel) if accel and accel_given else np.maximum(observed_accel, accel or 0.0),
        gyro_bounds=_bounds(gyro, observed_gyro),
        accel_bounds=_bounds(accel, observed_accel),
        gyro_walk=_walk(None if sheet is None else sheet.gyro_random_walk, grade, "gyro"),
        accel_walk=_walk(None if sheet is None else sheet.accel_random_walk, grade, "accel"),
        given=given,
        gyro_offset_sd=table.gyro_offset_sd or (grade.gyro_offset_sd if grade else None),
        accel_offset_sd=table.accel_offset_sd or (grade.accel_offset_sd if grade else None),
        gyro_scatter=min(gyro or np.inf, _size(observed_gyro)) * imu.interval**-0.5,
        gyro_drift=_drift(imu.rates, *flickers[0]),
        accel_drift=_drift(imu.accelerations, *flickers[1]),
        observed=(_size(observed_gyro), _size(observed_accel)),
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


def _drift(values: Array, bias_instability: float, density: float) -> float:
    """Return the deviation of what passes within seconds: flicker noise, and the error of coarse rounding.

    density: of the white noise, which may hide the flicker noise.
    """
    flicker = drift_size(bias_instability)
    if flicker * (2.0 * DRIFT_TIME) ** 0.5 < _HIDDEN * density:
        flicker = 0.0
    rounding = max(coarse_step(part) for part in excerpt(values)) / 12.0**0.5
    return math.hypot(flicker, rounding)


def _size(density: Array) -> float:
    """Return the rms over the axes."""
    return float(np.sqrt(np.mean(density**2)))


def _bounds(stated: float | None, observed: Array) -> tuple[float, float]:
    size = _size(observed)
    low = stated or _MIN_NOISE_SHARE * size
    return low, max(low, _MOTION_NOISE * size)


def readings_of(recording: Recording, noise: ImuNoise) -> Readings:
    """Return the IMU's readings, split at long gaps, with their noise."""
    imu = recording.imu
    cuts = gaps(imu.stamps_ns, LONG_GAP)
    edges = [0, *(int(k) + 1 for k in cuts), imu.stamps_ns.size]
    segments = tuple((a, b - 1) for a, b in pairwise(edges) if b - a >= 20)
    if not segments:
        raise RecordingError("no segment of 20 samples or more without a gap", file=imu.source)
    curvatures = [_usual_curvature(imu, values) for values in (imu.rates, imu.accelerations)]
    return Readings(
        imu.seconds,
        imu.rates,
        imu.accelerations,
        segments,
        noise=np.array([noise.gyro**2, noise.accel**2, *curvatures]),
        warmth=imu.warmth,
    )


def _usual_curvature(imu: ImuSamples, values: Array) -> Array:
    """Return the size of the second derivative the readings usually have, (3,)."""
    size = [np.percentile(np.abs(np.diff(part, n=2, axis=0)), 90, axis=0) for part in excerpt(values)]
    return np.asarray(np.median(size, axis=0) / imu.interval**2)

"""The IMU's readings with their noise: as stated, by grade, or estimated from the readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.inertial.noise_figures import (
    GAUSS_MARKOV_TIME,
    GRADES,
    coarse_step,
    equivalent_walk,
    gauss_markov_size,
    high_frequency_density,
    white_density,
)
from kreisel.inertial.readings import Readings
from kreisel.preparation.preparation import ImuNoise
from kreisel.recording.recording import ImuSamples, Recording, excerpt
from kreisel.validation.stamp_checks import LONG_GAP, gaps

_MIN_NOISE_SHARE, _MOTION_NOISE = 0.95, 20.0
"""Bounds of the noise that passes may find: the least where none is stated, over the white noise of the readings, and
the largest, over the noise by differences. Chosen: white noise is estimated to some per cent, and with less the errors
of 16 clean recordings without stated noise were 1.2 deviations; what is not modelled of a fast motion may count as
noise."""

_SENSORS: dict[Literal["gyro", "accel"], str] = {"gyro": "gyros", "accel": "accelerometers"}

_LEAST: dict[Literal["gyro", "accel"], float] = {"gyro": 1e-7, "accel": 1e-6}
"""Least noise densities, rad/s and m/s^2 per root of Hz. Chosen: below those of any sensor."""

MISSTATED = 4.0
"""Factor by which readings at rest are noisier than stated only if what is stated is of another device."""

DOUBTFUL = 1.3
"""The same factor from which on the noise at rest takes the place of what is stated."""

_QUIET, _PARTS = 200, 100
"""Samples of a part in which noise is looked for, and number of parts."""

_FEW, _BLOCK, _NO_MOTION = 3, 10, 3.0
"""Parts at rest that are enough, samples of a block, and how much more than white noise its mean may vary at rest."""

_HIDDEN = 0.5
"""Density of slow noise, as a share of that of the white noise, below which its effect on deviations is small."""


@dataclass(frozen=True)
class _Stated:
    """What is stated of one kind of sensors, SI; None or 0 where nothing is.

    density, walk, offset_sd
        See `ImuNoise`; `given` where the density is binding, and not a data sheet's.
    bias_instability
        Of the grade.
    """

    density: float | None
    given: bool
    walk: float
    offset_sd: float | None
    bias_instability: float


def imu_noise_of(recording: Recording) -> ImuNoise:
    """Return the IMU's noise: as given, by grade, or estimated from the readings.

    What is stated of sensors that are far noisier is not used: it is of another device.
    """
    imu = recording.imu
    stated = {name: _stated(recording, name) for name in _SENSORS}
    values = {"gyro": imu.rates, "accel": imu.accelerations}
    at_rest = {name: _at_rest(values[name], imu.interval) for name in stated}
    ratios = {name: at_rest[name] / (own.density or np.inf) for name, own in stated.items()}
    misstated = [name for name, ratio in ratios.items() if stated[name].given and ratio > MISSTATED]
    if misstated and recording.settings.imu.grade is not None:
        misstated = list(_SENSORS)  # a grade is of both
    stated |= {name: _Stated(None, False, 0.0, None, 0.0) for name in misstated}
    doubtful = {
        name: ratios[name] for name, own in stated.items() if own.given and own.density and ratios[name] > DOUBTFUL
    }
    stated |= {name: replace(stated[name], density=at_rest[name]) for name in doubtful}
    densities = {name: _densities(values[name], imu.interval, least) for name, least in _LEAST.items()}
    shaken, observed = ({name: found[k] for name, found in densities.items()} for k in range(2))
    gyro, accel = (stated[name] for name in _SENSORS)
    return ImuNoise(
        gyro=_density(gyro, observed["gyro"]),
        accel=_density(accel, observed["accel"]),
        gyro_bounds=_bounds(gyro.density, observed["gyro"], shaken["gyro"]),
        accel_bounds=_bounds(accel.density, observed["accel"], shaken["accel"]),
        gyro_walk=gyro.walk,
        accel_walk=accel.walk,
        given=gyro.given and accel.given,
        gyro_offset_sd=gyro.offset_sd,
        accel_offset_sd=accel.offset_sd,
        gyro_scatter=min(gyro.density or np.inf, _size(shaken["gyro"])) * imu.interval**-0.5,
        gyro_gauss_markov=_drift(imu.rates, gyro),
        accel_gauss_markov=_drift(imu.accelerations, accel),
        observed=np.array([observed["gyro"], observed["accel"]]),
        misstated={_SENSORS[name]: ratios[name] for name in misstated},
        doubtful={_SENSORS[name]: ratio for name, ratio in doubtful.items()},
    )


def noise_stated(recording: Recording) -> tuple[str, dict[str, float | None]] | None:
    """Return what is stated of the IMU's noise, and where; None if nothing is.

    The figures are `gyro_density`, `accel_density`, `gyro_walk` and `accel_walk`, SI.
    """
    table, grade = recording.settings.imu, recording.settings.imu.grade
    sources = []
    keys = [f"{sensor}_{what}" for sensor in ("gyro", "accel") for what in ("noise_density", "random_walk")]
    if any(getattr(table, key) is not None for key in keys):
        sources.append("recording.toml")
    if grade is not None:
        sources.append(f"grade {grade}")
    if recording.datasheet is not None:
        sources.append("sensor.yaml")
    if not sources:
        return None
    own = {name: _stated(recording, name) for name in _SENSORS}
    walks = grade is not None or recording.datasheet is not None or table.gyro_random_walk or table.accel_random_walk
    figures: dict[str, float | None] = {f"{name}_density": stated.density for name, stated in own.items()}
    return ", ".join(sources), figures | {
        f"{name}_walk": stated.walk if walks else None for name, stated in own.items()
    }


def _stated(recording: Recording, name: Literal["gyro", "accel"]) -> _Stated:
    """Return what settings, grade and data sheet state of one kind of sensors."""
    table, sheet, known = recording.settings.imu, recording.datasheet, GRADES.get(recording.settings.imu.grade or "")
    density = getattr(table, f"{name}_noise_density") or (getattr(known, f"{name}_noise_density") if known else None)
    offset_sd = getattr(table, f"{name}_offset_sd") or (getattr(known, f"{name}_offset_sd") if known else None)
    given = density is not None
    if sheet is not None and table.gyro_noise_density is None and table.accel_noise_density is None and known is None:
        density = getattr(sheet, f"{name}_noise_density")
    walk = getattr(table, f"{name}_random_walk")
    if walk is None and sheet is not None:
        walk = getattr(sheet, f"{name}_random_walk")
    if known is None:
        return _Stated(density, given, walk or 0.0, offset_sd, 0.0)
    instability = getattr(known, f"{name}_bias_instability")
    random_walk = known.gyro_rate_random_walk if name == "gyro" else known.accel_random_walk
    return _Stated(density, given, equivalent_walk(instability, random_walk) if walk is None else walk, offset_sd,
                   instability)  # fmt: skip


def _density(stated: _Stated, observed: Array) -> Array:
    """Return the density assumed for each axis."""
    if stated.given and stated.density:
        return np.full(3, stated.density)
    return np.maximum(observed, stated.density or 0.0)


def _densities(values: Array, interval: float, least: float) -> tuple[Array, Array]:
    """Return the density (3,) of readings (n, 3) at high frequencies, and of their white noise, at least `least`."""
    parts = excerpt(values)
    high = [high_frequency_density(part, interval) for part in parts]
    white = [white_density(part, interval, known) for part, known in zip(parts, high, strict=True)]
    shaken, observed = (np.maximum(np.median(found, axis=0), least) for found in (high, white))
    return shaken, observed


def _at_rest(values: Array, interval: float) -> float:
    """Return the noise density of readings (n, 3) at rest, rms over the axes; 0 if they are rounded, or never rest."""
    starts = np.arange(0, max(len(values) - _QUIET, 1), _QUIET)
    chosen = starts[np.linspace(0, starts.size - 1, min(starts.size, _PARTS)).astype(int)]
    parts = [values[start : start + _QUIET] for start in chosen]
    if len(values) < _QUIET or coarse_step(np.concatenate(parts)):
        return 0.0
    quiet = [d for part in parts if _rests(part, d := _size(white_density(part, interval)), interval)]
    return float(np.median(quiet)) if len(quiet) >= _FEW else 0.0


def _rests(values: Array, density: float, interval: float) -> bool:
    """Return whether readings (n, 3) of a noise density show nothing but noise: means over blocks differ as it says."""
    blocks = values[: len(values) // _BLOCK * _BLOCK].reshape(-1, _BLOCK, 3).mean(axis=1)
    return bool(_size(np.std(blocks, axis=0)) < _NO_MOTION * density * (_BLOCK * interval) ** -0.5)


def _drift(values: Array, stated: _Stated) -> float:
    """Return the deviation of what passes within seconds: flicker noise, and the error of coarse rounding."""
    flicker = gauss_markov_size(stated.bias_instability)
    if flicker * (2.0 * GAUSS_MARKOV_TIME) ** 0.5 < _HIDDEN * (stated.density or 0.0):
        flicker = 0.0
    return math.hypot(flicker, rounding_step(values) / 12.0**0.5)


def rounding_step(values: Array) -> float:
    """Return the step to which readings (n, 3) are rounded so coarsely that noise at rest does not average it, or 0."""
    return max(coarse_step(part) for part in excerpt(values))


def _size(density: Array) -> float:
    """Return the rms over the axes."""
    return float(np.sqrt(np.mean(density**2)))


def _bounds(stated: float | None, observed: Array, shaken: Array) -> tuple[float, float]:
    low = stated or _MIN_NOISE_SHARE * _size(observed)
    return low, max(low, _MOTION_NOISE * _size(shaken))


def readings_of(recording: Recording, noise: ImuNoise) -> Readings:
    """Return the IMU's readings, split at long gaps and where readings were cut off, with their noise."""
    imu = recording.imu
    after = np.unique(
        np.concatenate([gaps(imu.stamps_ns, LONG_GAP) + 1, np.searchsorted(imu.stamps_ns, imu.broken_ns)])
    )
    edges = [0, *after[(after > 0) & (after < imu.stamps_ns.size)].tolist(), imu.stamps_ns.size]
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
        temperature_difference=imu.temperature_difference,
    )


def _usual_curvature(imu: ImuSamples, values: Array) -> Array:
    """Return the size of the second derivative the readings usually have, (3,)."""
    size = [np.percentile(np.abs(np.diff(part, n=2, axis=0)), 90, axis=0) for part in excerpt(values)]
    return np.asarray(np.median(size, axis=0) / imu.interval**2)

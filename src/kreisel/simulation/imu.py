"""A simulated IMU: the sensor model of equations (1) and (2) solved for the raw values, and its grade's errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array, Mask, exp, matrix
from kreisel.inertial.noise_figures import Grade, noise
from kreisel.inertial.sensor_model import SensorParameters, size_effect
from kreisel.recording.recording import Stamps
from kreisel.simulation import low_pass
from kreisel.simulation.cell_settings import Imu
from kreisel.simulation.device_errors import DeviceEffects
from kreisel.units import DEG

_STALL, _STALLS, _APART_NS = 16e-3, 0.005, 10
"""Seconds by which a computer is late now and then, how often, and ns between stamps made at once."""

_MIN_BANDWIDTH = 0.1
"""Hz; smallest bandwidth."""


def draw_sensors(rng: np.random.Generator, imu: Imu, grade: Grade) -> SensorParameters:
    """Return the parameters of one device of a grade, mounted on the tool."""
    bend_rng = rng.spawn(1)[0]  # a separate random stream, so that all other draws stay the same
    order = 2 if imu.quadratic_gyro_sd > 0.0 or imu.quadratic_accel_sd > 0.0 else 1
    mount = matrix(exp(DEG * np.array(imu.mounting_deg)))
    scale_sds = (grade.gyro_scale_sd, grade.accel_scale_sd)
    quadratic = (imu.quadratic_gyro_sd, imu.quadratic_accel_sd)
    offset_sds = (grade.gyro_offset_sd, grade.accel_offset_sd)
    matrices, coefficients = [], []
    share = 1.0 if imu.errors else 0.0
    for scale_sd, offset_sd, bend in zip(scale_sds, offset_sds, quadratic, strict=True):
        off_diagonal = rng.normal(0.0, grade.misalignment_sd, size=(3, 3)) * (1.0 - np.eye(3))
        error = np.diag(rng.normal(0.0, scale_sd, size=3)) + off_diagonal
        matrices.append(mount @ (np.eye(3) + share * error))
        k = np.zeros((order, 3))
        k[0] = share * rng.normal(0.0, offset_sd, size=3)
        k[1:] = bend * bend_rng.normal(size=(order - 1, 3))
        coefficients.append(k)
    arms = np.array(imu.lever_arm) + share * rng.normal(0.0, imu.lever_arm_spread, size=(3, 3)) @ mount.T
    return SensorParameters(matrices[0], coefficients[0], matrices[1], coefficients[1], arms)


def ideal_readings(
    omega: Array, alpha: Array, force: Array, sensors: SensorParameters, effects: DeviceEffects | None = None,
    temperature_difference: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the raw rates and accelerations (n, 3) of a device without noise.

    Parameters
    ----------
    omega, alpha, force : (n, 3)
        Rate and angular acceleration against inertial space and specific force, all in b, of its origin.
    effects
        Further terms; the delay of the accelerometers is not among them.
    temperature_difference : (n,)
        Temperature above its mean, K.
    """
    effects = effects or DeviceEffects.none()
    w = omega @ np.linalg.inv(sensors.K_omega).T
    a = force @ np.linalg.inv(sensors.K_a).T + size_effect(omega, alpha, sensors)
    gyro_offset, gyro_scale, accel_offset, accel_scale = (
        part * (0.0 if temperature_difference is None else temperature_difference[:, None])
        for part in effects.temperature
    )
    accelerations = _solve(a - accel_offset, sensors.k_a, effects.accel_asymmetry, accel_scale)
    if np.any(effects.g_sensitivity):
        w = w - accelerations @ effects.g_sensitivity.T
    if np.any(effects.g_squared):
        w = w - accelerations**2 @ effects.g_squared.T
    return _solve(w - gyro_offset, sensors.k_w, effects.gyro_asymmetry, gyro_scale), accelerations


def _solve(y: Array, k: Array, c: Array, s: Array) -> Array:
    """Return x with (1 + s) x + k_0 + k_2 x^2 + ... + c |x| = y, by Newton's method."""
    x = y - k[0]
    if k.shape[0] == 1 and not np.any(c) and not np.any(s):
        return x
    for _ in range(100):
        value = (1.0 + s) * x + k[0] + c * np.abs(x) + sum(k[i] * x ** (i + 1) for i in range(1, k.shape[0])) - y
        step = value / _slope(x, k, c, s)
        x = x - step
        if not np.max(np.abs(step)) > 1e-14 * max(1.0, float(np.max(np.abs(y)))):
            break
    else:
        step = np.full(1, np.nan)
    if not np.isfinite(step).all() or not (_slope(x, k, c, s) > 0.1).all():
        raise SettingsError("imu.quadratic_…: no reading corresponds to some of the motion; take smaller coefficients")
    return np.asarray(x)


def _slope(x: Array, k: Array, c: Array, s: Array) -> Array:
    """Return the derivative of what `_solve` solves."""
    return np.asarray(1.0 + s + c * np.sign(x) + sum((i + 1) * k[i] * x**i for i in range(1, k.shape[0])))


def filtered(values: Array, rate: float, bandwidth: float, *, averaged: bool) -> Array:
    """Return the readings (n, 3) of a device of limited bandwidth, with its group delay.

    Parameters
    ----------
    bandwidth
        Hz, of a Butterworth low-pass of second order; 0 for none.
    averaged
        Whether readings are means over the sampling interval before.
    """
    if bandwidth <= 0.0 and not averaged:
        return values
    if 0.0 < bandwidth < _MIN_BANDWIDTH:
        raise SettingsError(f"imu.bandwidth {bandwidth:g} Hz; expected 0 (none), or {_MIN_BANDWIDTH:g} Hz and above")
    if bandwidth > 0.0:
        values = low_pass.low_passed(values, rate, bandwidth)
    return low_pass.averaged(values) if averaged else values


@dataclass(frozen=True)
class DeviceNoise:
    """Noise of one kind of sensors (n, 3): white, and slow (flicker and random walk), which moves the offsets."""

    white: Array
    slow: Array


def draw_noise(
    rng: np.random.Generator, imu: Imu, grade: Grade, n: int, rate: float
) -> tuple[DeviceNoise, DeviceNoise]:
    """Return the grade's noise of gyros and accelerometers; zeros for a device without noise."""
    if not imu.noise:
        none = DeviceNoise(np.zeros((n, 3)), np.zeros((n, 3)))
        return none, none
    gyro, accel = (
        DeviceNoise(noise(rng, n, rate, density, 0.0, 0.0), noise(rng, n, rate, 0.0, flicker, walk))
        for density, flicker, walk in (
            (grade.gyro_noise_density, grade.gyro_bias_instability, grade.gyro_rate_random_walk),
            (grade.accel_noise_density, grade.accel_bias_instability, grade.accel_random_walk),
        )
    )
    return gyro, accel


def disturbed(
    imu: Imu, grade: Grade, rate: float, readings: tuple[Array, Array], drift: tuple[Array, Array],
    noises: tuple[DeviceNoise, DeviceNoise],
) -> tuple[Array, Array]:  # fmt: skip
    """Return the readings (n, 3) with the errors of the settings and the grade: bandwidth, drift, noise, rounding.

    Parameters
    ----------
    readings, drift, noises : (n, 3), twice
        Of gyros and accelerometers: ideal readings, by how much changing offsets let them read too much, and noise.
    """
    bandwidth = grade.bandwidth if imu.bandwidth is None else imu.bandwidth
    bandwidths = (bandwidth, bandwidth if imu.accel_bandwidth is None else imu.accel_bandwidth)
    ranges = (grade.gyro_range, grade.accel_range)
    steps = [step if imu.noise else 0.0 for step in (grade.gyro_step, grade.accel_step)]
    steps = [
        own if said is None else said for said, own in zip((imu.gyro_quantum, imu.accel_quantum), steps, strict=True)
    ]
    out = []
    for k in range(2):
        values = filtered(readings[k], rate, bandwidths[k], averaged=imu.averaged) + drift[k]
        if imu.noise:
            values = np.clip(values + (noises[k].white + noises[k].slow), -ranges[k], ranges[k])
        out.append(rounded(values, steps[k]))
    return out[0], out[1]


def rounded(values: Array, step: float) -> Array:
    """Return values rounded to multiples of a step; 0: as they are."""
    return np.asarray(np.round(values / step) * step) if step > 0.0 else values


def stamped(imu: Imu, rng: np.random.Generator, stamps_ns: Stamps, keep: Mask) -> Stamps:
    """Return the stamps of the samples that are kept, as the device or the computer beside it makes them."""
    stamps = stamps_ns[keep]
    if imu.counted:
        return stamps_ns[: stamps.size]
    if imu.lateness == 0.0 and imu.burst == 1:
        return stamps
    n = stamps.size
    late = rng.exponential(max(imu.lateness, 1e-9), n) + _STALL * (rng.random(n) < _STALLS)
    last = np.minimum((np.arange(n) // imu.burst + 1) * imu.burst, n) - 1  # of the samples that arrive together
    arrival = np.maximum.accumulate(stamps[last] + np.round(1e9 * late[last]).astype(np.int64))
    return arrival + _APART_NS * np.arange(n)

"""A simulated IMU: the sensor model of equations (1) and (2) solved for the raw values, and its grade's errors."""

from __future__ import annotations

import numpy as np

from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array, exp, matrix
from kreisel.inertial.noise import Grade, noise
from kreisel.inertial.sensor_model import SensorParameters, size_effect
from kreisel.simulation.settings import Imu
from kreisel.units import DEG

_FINER = 8
"""Points for each sample where readings are filtered."""

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
    arms = np.array(imu.lever_arm) + share * rng.normal(0.0, imu.lever_arm_spread, size=(3, 3))
    return SensorParameters(matrices[0], coefficients[0], matrices[1], coefficients[1], arms)


def ideal_readings(omega: Array, alpha: Array, force: Array, sensors: SensorParameters) -> tuple[Array, Array]:
    """Return the raw rates and accelerations (n, 3) of a device without noise.

    Parameters
    ----------
    omega, alpha, force : (n, 3)
        Rate and angular acceleration against inertial space and specific force, all in b, of its origin.
    """
    w = omega @ np.linalg.inv(sensors.K_omega).T
    a = force @ np.linalg.inv(sensors.K_a).T + size_effect(omega, alpha, sensors)
    return _solve(w, sensors.k_w), _solve(a, sensors.k_a)


def _solve(y: Array, k: Array) -> Array:
    """Return x with x + k_0 + k_2 x^2 + ... = y, by Newton's method."""
    x = y - k[0]
    if k.shape[0] == 1:
        return x
    for _ in range(100):
        value = x + k[0] + sum(k[i] * x ** (i + 1) for i in range(1, k.shape[0])) - y
        slope = 1.0 + sum((i + 1) * k[i] * x**i for i in range(1, k.shape[0]))
        step = value / slope
        x = x - step
        if not np.max(np.abs(step)) > 1e-14 * max(1.0, float(np.max(np.abs(y)))):
            break
    else:
        step = np.full(1, np.nan)
    if not np.isfinite(step).all() or not (1.0 + sum((i + 1) * k[i] * x**i for i in range(1, k.shape[0])) > 0.1).all():
        raise SettingsError("imu.quadratic_…: no reading corresponds to some of the motion; take smaller coefficients")
    return np.asarray(x)


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
    from scipy.interpolate import CubicSpline  # comes with the extra `robot`

    n = values.shape[0]
    spline = CubicSpline(np.arange(n) / rate, values)
    if bandwidth > 0.0:
        from scipy.signal import bilinear, lfilter, lfilter_zi

        fine = spline(np.arange((n - 1) * _FINER + 1) / (rate * _FINER))
        pole = 2.0 * np.pi * bandwidth
        b, a = bilinear([pole**2], [1.0, np.sqrt(2.0) * pole, pole**2], fs=rate * _FINER)
        state = lfilter_zi(b, a)[:, None] * fine[0]
        out, _ = lfilter(b, a, fine, axis=0, zi=state)
        values = out[::_FINER]
        spline = CubicSpline(np.arange(n) / rate, values)
    if averaged:
        integral = spline.antiderivative()(np.arange(n) / rate)
        values = values.copy()
        values[1:] = np.diff(integral, axis=0) * rate
    return np.asarray(values)


def disturbed(
    rng: np.random.Generator, imu: Imu, grade: Grade, rate: float, rates: Array, accelerations: Array, force: Array
) -> tuple[Array, Array]:
    """Return the readings (n, 3) with the errors of the settings and the grade: bandwidth, drift, noise, rounding."""
    n = rates.shape[0]
    bandwidth = grade.bandwidth if imu.bandwidth is None else imu.bandwidth
    w = filtered(rates, rate, bandwidth, averaged=imu.averaged)
    a = filtered(accelerations, rate, bandwidth, averaged=imu.averaged)
    ramp = np.linspace(0.0, 1.0, n)[:, None]
    w, a = w + imu.gyro_temperature_drift * ramp, a + imu.accel_temperature_drift * ramp
    if not imu.noise:
        return w, a
    w = w + noise(rng, n, rate, grade.gyro_noise_density, grade.gyro_bias_instability, grade.gyro_rate_random_walk)
    a = a + noise(rng, n, rate, grade.accel_noise_density, grade.accel_bias_instability, grade.accel_random_walk)
    if grade.g_sensitivity > 0.0:
        w = w + force @ rng.normal(0.0, grade.g_sensitivity, size=(3, 3)).T
    return _digitised(w, grade.gyro_range, grade.gyro_step), _digitised(a, grade.accel_range, grade.accel_step)


def _digitised(values: Array, largest: float, step: float) -> Array:
    values = np.clip(values, -largest, largest)
    return np.asarray(np.round(values / step) * step) if step > 0.0 else values

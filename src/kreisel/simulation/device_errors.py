"""What a simulated device does beyond equations (1) and (2): terms, offsets that change, vibration, faulty samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from kreisel.geometry.rotation import Array, exp, lengths, matrix
from kreisel.inertial.noise_figures import Grade
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.robot.motion import Timeline
from kreisel.simulation.cell_settings import Imu
from kreisel.units import DEG

_RATE_OF_VIBRATION = 1e-3
"""rad/s for each m/s^2 of vibration."""

_RATE_OF_PROPELLERS, _ROTOR, _TONES, _THRUST = 0.03, 95.0, 0.875, 0.5
"""rad/s for each m/s^2, Hz, share of the tones in the power, and amplitude of the logarithm of the size, all as in
recordings of a small drone."""

_PHASE_WALK = 0.5
"""rad per root second: the vibration's phase drifts."""

_RAMP = 0.25
"""s in which vibration and sway begin and end, within a move."""

_INSTANT = (np.zeros(1), np.ones(1))
_WINDOW = hermegauss(7)
"""Places, in standard deviations, and weights of an instant and of a window."""

_SPIKE = 10.0
"""A spike is so many times as large as usual readings."""


@dataclass(frozen=True)
class DeviceEffects:
    """Terms of the sensor model beyond offsets, cross-coupling and powers; from readings to true values, SI.

    Attributes
    ----------
    g_sensitivity : (3, 3)
        omega = K_omega (w' + k_w0 + G a' + ...), rad/s per m/s^2.
    gyro_asymmetry, accel_asymmetry : (3,)
        Coefficients of |w'| and |a'|.
    accel_delay
        By how much accelerometers are later than gyros, s.
    axis_delay, axis_window : (3,)
        By how much the axes of both sensors are late, and standard deviations of the windows they are means over, s.
    g_squared : (3, 3)
        The same for squares of the accelerations, rad/s per (m/s^2)^2.
    temperature : (4, 3)
        What is added for each K above the mean: to the rates, and for each rad/s of them, to the accelerations, and for
        each m/s^2 of them.
    """

    g_sensitivity: Array
    gyro_asymmetry: Array
    accel_asymmetry: Array
    accel_delay: float = 0.0
    axis_delay: Array = field(default_factory=lambda: np.zeros(3))
    axis_window: Array = field(default_factory=lambda: np.zeros(3))
    g_squared: Array = field(default_factory=lambda: np.zeros((3, 3)))
    temperature: Array = field(default_factory=lambda: np.zeros((4, 3)))

    @classmethod
    def none(cls) -> DeviceEffects:
        """Return those of a device that has none."""
        return cls(np.zeros((3, 3)), np.zeros(3), np.zeros(3))

    @property
    def axis_smoothing(self) -> Array:
        """Half the variance of each axis's window, s^2, (3,)."""
        return 0.5 * self.axis_window**2

    def seen(self, ideal: Callable[[float], tuple[Array, Array]]) -> tuple[Array, Array]:
        """Return readings (n, 3) each of axes that are late and are means over windows.

        ideal: from seconds that readings are late to those of all axes. A window is a normal distribution, by Gauss
        and Hermite's rule.
        """
        late = cache(ideal)
        out = np.zeros((2, *late(0.0)[0].shape))
        for sensor, axis in np.ndindex(2, 3):
            delay = (0.0, self.accel_delay)[sensor] + self.axis_delay[axis]
            sd = self.axis_window[axis]
            places, weights = _WINDOW if sd > 0.0 else _INSTANT
            for place, weight in zip(places, weights / weights.sum(), strict=True):
                out[sensor, :, axis] += weight * late(float(delay + place * sd))[sensor][:, axis]
        return out[0], out[1]


@dataclass(frozen=True)
class OffsetChange:
    """What is added to the offsets k_w0 and k_a0 by drift, warming up, steps, walks and flicker noise, SI.

    Attributes
    ----------
    gyro_mean, gyro_end, accel_mean, accel_end : (3,)
        Mean over the recording, and value at its end; of flicker noise the mean in both.
    """

    gyro_mean: Array
    gyro_end: Array
    accel_mean: Array
    accel_end: Array


@dataclass(frozen=True)
class Slip:
    """A turn of the IMU in its mount: rotation vector in the tool's frame, rad, and IMU seconds."""

    turn: Array
    time: float

    def after(self, sensors: SensorParameters) -> SensorParameters:
        """Return the device's parameters after it."""
        C = matrix(exp(self.turn))
        return replace(sensors, K_omega=C @ sensors.K_omega, K_a=C @ sensors.K_a)


def draw_effects(rng: np.random.Generator, imu: Imu, grade: Grade) -> DeviceEffects:
    """Return the terms of one device."""
    linear, squared = (
        (own if imu.noise else 0.0) if said is None else said
        for said, own in (
            (imu.gyro_g_sensitivity_sd, grade.g_sensitivity), (imu.gyro_g_squared_sd, grade.g_squared)
        )
    )  # fmt: skip
    of_temperature = (
        imu.gyro_temperature_sd, imu.gyro_scale_temperature_sd, imu.accel_temperature_sd, imu.accel_scale_temperature_sd
    )  # fmt: skip
    return DeviceEffects(
        linear * rng.normal(size=(3, 3)),
        imu.gyro_asymmetry_sd * rng.normal(size=3),
        imu.accel_asymmetry_sd * rng.normal(size=3),
        imu.accel_delay,
        imu.axis_delay * np.array([-1.0, 0.0, 1.0]),
        imu.axis_smoothing * np.array([0.0, 0.5, 1.0]),
        squared * rng.spawn(1)[0].normal(size=(3, 3)),
        np.array(of_temperature)[:, None] * rng.normal(size=(4, 3)),
    )


def temperature_of(imu: Imu, t: Array) -> Array | None:
    """Return the sensor's temperature (n,), degrees Celsius, or None where it is not recorded."""
    if imu.temperature_rise == 0.0:
        return None
    return np.asarray(25.0 + imu.temperature_rise * (1.0 - np.exp(-t / imu.warm_up_time)))


def at_mean_temperature(
    sensors: SensorParameters, effects: DeviceEffects, imu: Imu, seconds: float
) -> SensorParameters:
    """Return the sensors, drawn at 25 degrees, at a recording's mean temperature, where the difference is zero."""
    temperature = temperature_of(imu, np.linspace(0.0, seconds, 10_000))
    if temperature is None:
        return sensors
    above = float(temperature.mean()) - 25.0
    gyro, gyro_scale, accel, accel_scale = (above * one for one in effects.temperature)
    k_w, k_a = sensors.k_w.copy(), sensors.k_a.copy()
    k_w[0], k_a[0] = (k_w[0] + gyro) / (1.0 + gyro_scale), (k_a[0] + accel) / (1.0 + accel_scale)
    K_omega, K_a = sensors.K_omega * (1.0 + gyro_scale), sensors.K_a * (1.0 + accel_scale)
    return replace(sensors, K_omega=K_omega, k_w=k_w, K_a=K_a, k_a=k_a)


def draw_slip(rng: np.random.Generator, imu: Imu, seconds: float) -> Slip | None:
    """Return the turn in the mount, or None."""
    axis, time = rng.normal(size=3), middle(rng, seconds)
    return Slip(imu.slip_deg * DEG * axis / np.linalg.norm(axis), time) if imu.slip_deg > 0.0 else None


def middle(rng: np.random.Generator, seconds: float) -> float:
    """Return a random time in the middle half of a recording."""
    return float(seconds * rng.uniform(0.25, 0.75))


def offset_drift(rng: np.random.Generator, imu: Imu, t: Array) -> tuple[Array, Array]:
    """Return what gyros and accelerometers read too much because their offsets change, (n, 3) each."""
    gyro = (imu.gyro_temperature_drift, imu.gyro_walk, imu.gyro_step, imu.gyro_warm_up)
    accel = (imu.accel_temperature_drift, imu.accel_walk, imu.accel_step, imu.accel_warm_up)
    first, second = (
        _drift(own, t, sizes, imu.warm_up_time) for own, sizes in zip(rng.spawn(2), (gyro, accel), strict=True)
    )
    return first, second


def _drift(rng: np.random.Generator, t: Array, sizes: tuple[float, float, float, float], warm_up_time: float) -> Array:
    ramp, walk, step, warm_up = sizes
    signs = rng.choice([-1.0, 1.0], size=(2, 3))
    late = t >= middle(rng, float(t[-1]))
    out = np.repeat(ramp * np.linspace(0.0, 1.0, t.size)[:, None], 3, axis=1)
    if step > 0.0:
        out += step * signs[0] * late[:, None]
    if warm_up > 0.0:
        out += warm_up * signs[1] * np.exp(-t / warm_up_time)[:, None]
    if walk > 0.0:
        out += np.cumsum(rng.normal(size=out.shape) * walk * np.sqrt(np.diff(t, prepend=t[0]))[:, None], axis=0)
    return out


def offset_change(drift: tuple[Array, Array], slow: tuple[Array, Array]) -> OffsetChange:
    """Return mean and end of the corrections, for gyros and accelerometers.

    Parameters
    ----------
    drift, slow : (n, 3), twice
        By how much readings are too large: by changes of the settings, and by slow noise of the grade.
    """
    noise = [s.mean(axis=0) for s in slow]
    means = [-(d.mean(axis=0) + level) for d, level in zip(drift, noise, strict=True)]
    ends = [-(d[-1] + level) for d, level in zip(drift, noise, strict=True)]
    return OffsetChange(means[0], ends[0], means[1], ends[1])


def envelope(planned: Timeline, t: Array) -> tuple[Array, Array, Array]:
    """Return the share (n,) with which vibration and sway are there, and its first and second derivative.

    It is 0 at standstill and 1 within moves; it rises and falls with two continuous derivatives.
    """
    begin, end = planned.standstills[:-1, 1], planned.standstills[1:, 0]
    if not begin.size:
        zero = np.zeros_like(t)
        return zero, zero, zero
    k = np.clip(np.searchsorted(begin, t, side="right") - 1, 0, begin.size - 1)
    ramp = np.minimum(_RAMP, 0.5 * (end - begin))[k]
    rise, fall = smooth_step((t - begin[k]) / ramp), smooth_step((end[k] - t) / ramp)
    return (
        rise[0] * fall[0],
        (rise[1] * fall[0] - rise[0] * fall[1]) / ramp,
        (rise[2] * fall[0] - 2.0 * rise[1] * fall[1] + rise[0] * fall[2]) / ramp**2,
    )


def smooth_step(x: Array) -> tuple[Array, Array, Array]:
    """Return a smooth step from 0 at x = 0 to 1 at x = 1, and its first and second derivative."""
    x = np.clip(x, 0.0, 1.0)
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        30.0 * x**2 * (1.0 - x) ** 2,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
    )


def vibration(rng: np.random.Generator, imu: Imu, planned: Timeline, t: Array) -> tuple[Array, Array]:
    """Return rate and specific force (n, 3) of the vibration, in b."""
    if imu.propellers > 0.0:
        return _propellers(rng, imu, planned, t)
    if imu.vibration == 0.0:
        return np.zeros((t.size, 3)), np.zeros((t.size, 3))
    directions = rng.normal(size=(2, 3))
    directions /= lengths(directions)[:, None]
    drift = _PHASE_WALK * np.cumsum(rng.normal(size=t.size) * np.sqrt(np.diff(t, prepend=t[0])))
    size = np.sqrt(2.0) * imu.vibration * envelope(planned, t)[0]
    wave = size * np.sin(2.0 * np.pi * imu.vibration_frequency * t + drift)
    return _RATE_OF_VIBRATION * wave[:, None] * directions[0], wave[:, None] * directions[1]


def _propellers(rng: np.random.Generator, imu: Imu, planned: Timeline, t: Array) -> tuple[Array, Array]:
    """Return rate and specific force (n, 3) of a body shaken by rotors.

    Of the power, seven parts in eight are tones of four rotors, whose speed varies about `_ROTOR`, and one is noise;
    the size follows the thrust, which changes within seconds. Rates have `_RATE_OF_PROPELLERS` for each m/s^2.
    """
    step = np.sqrt(np.diff(t, prepend=t[0]))
    size = imu.propellers * (
        envelope(planned, t)[0] if len(planned.standstills) > 1 and np.ptp(planned.standstills[0]) else 1.0
    )
    size = size * np.exp(_THRUST * np.sin(2.0 * np.pi * rng.uniform(0.02, 0.1) * t + rng.uniform(0.0, 2.0 * np.pi)))
    axes = np.array([1.0, 0.4, 0.9])
    out = []
    for share in (_RATE_OF_PROPELLERS, 1.0):
        speed = _ROTOR * rng.uniform(0.9, 1.1, 4)[:, None] * (1.0 + 0.03 * np.sin(0.7 * t + rng.uniform(0, 6, (4, 1))))
        phase = 2.0 * np.pi * np.cumsum(speed, axis=1) * float(np.median(np.diff(t)))
        phase = phase + 3.0 * np.cumsum(rng.normal(size=phase.shape) * step, axis=1)
        directions = rng.normal(size=(4, 3)) * axes
        tones = np.sin(phase).T @ (directions * (2.0 * _TONES / np.sum(directions**2)) ** 0.5)
        noise = rng.normal(size=tones.shape) * axes * ((1.0 - _TONES) / np.sum(axes**2)) ** 0.5
        out.append(share * np.broadcast_to(size, t.shape)[:, None] * (tones + noise))
    return out[0], out[1]


def with_faults(rng: np.random.Generator, imu: Imu, rates: Array, accelerations: Array) -> tuple[Array, Array]:
    """Return readings (n, 3) with spikes, and with samples that repeat the one before."""
    if imu.spike_share == imu.stuck_share == 0.0:
        return rates, accelerations
    n = rates.shape[0]
    draws, sign = rng.uniform(size=(2, n)), rng.choice([-1.0, 1.0], n)
    channel = rng.integers(0, 6, size=(n,))
    readings = np.hstack([rates, accelerations])
    usual = np.repeat([np.sqrt(np.mean(rates**2)), np.sqrt(np.mean(accelerations**2))], 3)
    rows = np.flatnonzero(draws[0] < imu.spike_share)
    readings[rows, channel[rows]] = (_SPIKE * usual[channel] * sign)[rows]
    fresh = np.where(draws[1] < imu.stuck_share, 0, np.arange(n))
    readings = readings[np.maximum.accumulate(fresh)]
    return readings[:, :3], readings[:, 3:]

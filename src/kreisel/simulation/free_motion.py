"""A recording of a body that moves freely under motion capture: it needs neither an arm nor what belongs to one."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array, apply, conjugate, exp, multiply
from kreisel.inertial.earth import EARTH_RATE
from kreisel.inertial.sensor_model import SensorParameters, size_effect
from kreisel.recording.recording import Recording
from kreisel.validation.recording_from_arrays import from_arrays

IMU_RATE, FINE, POSES = 200.0, 10, 2
"""Samples a second, steps of the integration in a sample, samples between two poses."""

LATITUDE_DEG, GRAVITY = 50.0, 9.8107
"""deg and m/s^2: a chosen place, and normal gravity there at sea level (`inertial.earth`)."""

GYRO_NOISE, ACCEL_NOISE = 3e-5, 3e-4
"""Densities, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz)."""

POSITION_NOISE, ORIENTATION_NOISE = 2e-4, 3e-4
"""Of the poses, m and rad."""

TIME_OFFSET = 0.0123
"""s: t_imu = t_ref + this."""


def free_recording(seconds: float, rng: np.random.Generator) -> tuple[SensorParameters, Recording]:
    """Return the true parameters of a device drawn at random, and a recording of it.

    Notes
    -----
    Rates and positions are sums of sines, their derivatives closed forms; the attitude is integrated in steps of 0.5
    ms. r points north, west and up.
    """
    truth = SensorParameters(
        K_omega=np.eye(3) + rng.normal(0.0, 5e-3, (3, 3)),
        k_w=rng.normal(0.0, 2e-3, (1, 3)),
        K_a=np.eye(3) + rng.normal(0.0, 5e-3, (3, 3)),
        k_a=rng.normal(0.0, 0.05, (1, 3)),
        lever_arms=np.array([0.05, -0.03, 0.08]) + rng.normal(0.0, 0.01, (3, 3)),
    )
    fine = np.arange(int(seconds * IMU_RATE) * FINE + 1) / (IMU_RATE * FINE)
    turning, path = _sines(rng, 1.1, 0.8), _sines(rng, 0.25, 0.35)
    middle = 0.5 * (fine[1:] + fine[:-1])
    steps = exp(_values(turning, middle, 0) / (IMU_RATE * FINE))
    q = np.empty((fine.size, 4))
    q[0] = exp(rng.normal(0.0, 0.5, 3))
    for k, step in enumerate(steps):
        q[k + 1] = multiply(q[k], step)
    t, q = fine[::FINE], q[::FINE]
    earth_r = EARTH_RATE * np.array([np.cos(np.deg2rad(LATITUDE_DEG)), 0.0, np.sin(np.deg2rad(LATITUDE_DEG))])
    omega_rb, alpha_rb = _values(turning, t, 0), _values(turning, t, 1)
    earth_b = apply(conjugate(q), np.broadcast_to(earth_r, (t.size, 3)))
    omega, alpha = omega_rb + earth_b, alpha_rb - np.cross(omega_rb, earth_b)
    coriolis = 2.0 * np.cross(earth_r, _values(path, t, 1))
    force = apply(conjugate(q), _values(path, t, 2) + coriolis + [0.0, 0.0, GRAVITY])
    rates = omega @ np.linalg.inv(truth.K_omega).T - truth.k_w[0]
    accelerations = force @ np.linalg.inv(truth.K_a).T + size_effect(omega, alpha, truth) - truth.k_a[0]
    rates += rng.normal(0.0, GYRO_NOISE * IMU_RATE**0.5, rates.shape)
    accelerations += rng.normal(0.0, ACCEL_NOISE * IMU_RATE**0.5, accelerations.shape)
    own = slice(0, None, POSES)
    positions = _values(path, t[own], 0) + rng.normal(0.0, POSITION_NOISE, (t[own].size, 3))
    orientations = multiply(q[own], exp(rng.normal(0.0, ORIENTATION_NOISE, (t[own].size, 3))))
    settings = {
        "imu": {"gyro_noise_density": GYRO_NOISE, "accel_noise_density": ACCEL_NOISE},
        "site": {"latitude_deg": LATITUDE_DEG, "gravity": GRAVITY, "gravity_sd": 1e-5},
        "reference": {"kind": "mocap", "position_sd": POSITION_NOISE, "orientation_sd": ORIENTATION_NOISE},
    }
    stamps = (10.0 + t) * 1e9
    return truth, from_arrays(
        stamps.astype(np.int64), rates, accelerations, ((stamps - 1e9 * TIME_OFFSET)[own]).astype(np.int64), positions,
        orientations, settings=settings, name="free motion",
    )  # fmt: skip


def _sines(rng: np.random.Generator, size: float, fastest: float) -> Array:
    """Return amplitude, angular frequency and phase of four sines for each of three coordinates, (3, 3, 4)."""
    frequency = 2.0 * np.pi * rng.uniform(0.1, fastest, (3, 4))
    return np.array([size * rng.uniform(0.4, 1.0, (3, 4)) / 2.0, frequency, rng.uniform(0.0, 2.0 * np.pi, (3, 4))])


def _values(sines: Array, t: Array, order: int) -> Array:
    """Return the derivative of an order (n, 3) of sums of sines."""
    amplitude, frequency, phase = sines
    argument = frequency * t[:, None, None] + phase + order * np.pi / 2.0
    return np.asarray((amplitude * frequency**order * np.sin(argument)).sum(axis=-1))

"""Errors of known shape that the sensor model has no name for: of a sensor's readings, and of reported poses."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.simulation.cell_settings import Unlisted

_JUMP_TURN = 1.0
"""rad for each m by which a reference jumps, or drifts."""


def of_readings(
    settings: Unlisted, rng: np.random.Generator, t: Array, rates: Array, accelerations: Array
) -> tuple[Array, Array]:
    """Return what is added to ideal raw rates and accelerations (n, 3) at times t (n,)."""
    signs = rng.choice([-1.0, 1.0], size=(4, 3))
    gyro, accel = settings.gyro_cubic * signs[0] * rates**3, np.zeros_like(accelerations)
    if settings.accel_products > 0.0:
        products = accelerations[:, [1, 2, 0]] * accelerations[:, [2, 0, 1]]
        accel += products @ (settings.accel_products * rng.normal(size=(3, 3)))
    if settings.scale_drift > 0.0:
        share = (t - t[0]) / (t[-1] - t[0]) - 0.5
        gyro += settings.scale_drift * signs[1] * share[:, None] * rates
        accel += settings.scale_drift * signs[2] * share[:, None] * accelerations
    if settings.hysteresis > 0.0:
        gyro += settings.hysteresis * _play(rates)
        accel += settings.hysteresis * _play(accelerations)
    if settings.dead_zone > 0.0:
        gyro -= np.clip(rates, -settings.dead_zone, settings.dead_zone)
    return gyro, accel


def _play(values: Array) -> Array:
    """Return by how much values (n, 3) lead a follower with a play of half their rms, in units of the values."""
    width = 0.5 * np.sqrt(np.mean(values**2, axis=0))
    out, at = np.empty_like(values), values[0].copy()
    for i, value in enumerate(values):
        at = np.clip(at, value - width, value + width)
        out[i] = at
    return values - out


def of_poses(settings: Unlisted, rng: np.random.Generator, t: Array, p: Array) -> Array:
    """Return what is added to reported poses at positions p (n, 3): position in r, small rotation in r, (n, 6)."""
    out = np.zeros((t.size, 6))
    if settings.axis_scale > 0.0:
        out[:, :3] += settings.axis_scale * np.array([-1.0, 0.0, 1.0]) * (p - p.mean(axis=0))
    if settings.base_tilt > 0.0:  # about the level axis across the tool, as the torque of its weight
        tilt = settings.base_tilt * np.column_stack([-p[:, 1], p[:, 0], np.zeros(t.size)])
        out += np.hstack([np.cross(tilt, p), tilt])
    direction = rng.normal(size=6) / 3.0**0.5
    size = np.array([*[1.0] * 3, *[_JUMP_TURN] * 3]) * direction
    if settings.reference_jump > 0.0:
        late = t > t[0] + (t[-1] - t[0]) * rng.uniform(0.25, 0.75)
        out += settings.reference_jump * size * late[:, None]
    if settings.reference_drift > 0.0:
        steps = rng.normal(size=(t.size, 6)) * np.sqrt(np.diff(t, prepend=t[0]))[:, None]
        out += settings.reference_drift * np.cumsum(steps, axis=0) * np.array([*[1.0] * 3, *[_JUMP_TURN] * 3])
    return out

"""What a format cannot hold, in the units of data sheets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, lengths, skew
from kreisel.inertial.effects import OF_CHANGE, RawReadings, added
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.groups import group_named
from kreisel.model.parameters import DELAYS, SMOOTHINGS
from kreisel.units import DEG, DEG_PER_HOUR, MG, MRAD, MS, PPM, STANDARD_GRAVITY

RATE = 100.0 * DEG
"""Rate at which losses are stated, rad/s."""

TURNING = 10.0
"""Angular acceleration at which losses are stated, rad/s^2."""

CHANGE = 10.0
"""Derivatives of force and rate at which losses of delay and smoothing are stated, m/s^3 (m/s^4), rad/s^2 (rad/s^3)."""

_MOVING = {
    **dict.fromkeys((*DELAYS, *SMOOTHINGS), " and 10 m/s^3"),
    **dict.fromkeys(OF_CHANGE, " and 10 rad/s^2"),
}

TEMPERATURE_CHANGE = 10.0
"""Kelvin above the calibration's temperature at which losses are stated."""

LASTING = 600.0
"""Seconds from the first stamp after which the loss of a clock's skew is stated."""

_SMALLEST_MG, _SMALLEST_DEG_H, _SMALLEST_PPM = 1e-3, 1e-3, 0.1
"""Smaller losses are not stated. Chosen: a hundredth of the offset of the best grade, ring-laser (0.1 mg), a thirtieth
of that of its gyros (0.03 deg/h), and a part in 2000 of that of its scale factors (200 ppm)."""


def losses(full: SensorParameters, held: SensorParameters) -> tuple[str, ...]:
    """Return what is lost where a format holds `held` in place of `full`, both in the same axes.

    Each text says how large the error is at 1 g, 100 deg/s, 10 rad/s^2, 10 m/s^3 or 10 K.
    """
    out = []
    scale, misaligned = _matrix(held.K_a @ np.linalg.inv(full.K_a))
    out += _told("the accelerometers' scale factors", scale / PPM, _SMALLEST_PPM, "ppm")
    out += _told(
        "the accelerometers' misalignment", misaligned / MRAD, 1e-4, "mrad", f"{1e3 * misaligned:.3g} mg at 1 g"
    )
    scale, misaligned = _matrix(held.K_omega @ np.linalg.inv(full.K_omega))
    out += _told(
        "the gyros' scale factors", scale / PPM, _SMALLEST_PPM, "ppm",
        f"{scale * RATE / DEG_PER_HOUR:.3g} deg/h at 100 deg/s",
    )  # fmt: skip
    out += _told(
        "the gyros' misalignment", misaligned / MRAD, 1e-4, "mrad",
        f"{misaligned * RATE / DEG_PER_HOUR:.3g} deg/h at 100 deg/s",
    )  # fmt: skip
    offset = _largest(held.k_a[0] - full.k_a[0]) / MG
    out += _told("the accelerometers' bias", offset, _SMALLEST_MG, "mg")
    offset = _largest(held.k_w[0] - full.k_w[0]) / DEG_PER_HOUR
    out += _told("the gyros' bias", offset, _SMALLEST_DEG_H, "deg/h")
    out += _arms(full, held)
    for group, value in full.effects.items():
        left = np.asarray(value, dtype=float).ravel() - np.asarray(held.effects.get(group, 0.0), dtype=float).ravel()
        out += _effect(group, left)
    return tuple(out)


def clock_losses(skew: float) -> tuple[str, ...]:
    """Return what is lost where a format holds no ratio of clocks, 1 + skew."""
    gained = abs(skew) * LASTING / MS
    return tuple(_told("the clock's skew", abs(skew) / PPM, _SMALLEST_PPM, "ppm", f"{gained:.3g} ms after ten minutes"))


def without_effects_of(p: SensorParameters) -> SensorParameters:
    """Return parameters without polynomials and further effects."""
    return replace(p, k_w=p.k_w[:1], k_a=p.k_a[:1], others={})


def _matrix(ratio: Array) -> tuple[float, float]:
    """Return the largest error of scale, and of direction (rad), of a matrix that should be the identity."""
    error = ratio - np.eye(3)
    return _largest(np.diag(error)), float(lengths(error - np.diag(np.diag(error))).max())


def _arms(full: SensorParameters, held: SensorParameters) -> list[str]:
    """Return the error of the specific force for positions that are not held: s_j . ([alpha x] + [omega x]^2) r_j."""
    wrong = full.lever_arms - held.lever_arms
    axes = np.linalg.inv(full.K_a)
    fast, rising = skew(RATE * np.eye(3)), skew(TURNING * np.eye(3))
    turning = max(_largest(np.einsum("jk,kl,jl->j", axes, W @ W, wrong)) for W in fast) / MG
    speeding = max(_largest(np.einsum("jk,kl,jl->j", axes, A, wrong)) for A in rising) / MG
    if max(turning, speeding) < _SMALLEST_MG:
        return []
    return [
        f"the positions of the accelerometers (up to {1e3 * float(lengths(wrong).max()):.3g} mm): "
        f"{turning:.3g} mg at 100 deg/s, {speeding:.3g} mg at 10 rad/s^2"
    ]


def _effect(group: str, value: Array) -> list[str]:
    """Return the largest of what an effect adds, over readings of 1 g and 100 deg/s along every axis, both signs."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    raw = RawReadings(
        np.arange(6.0),
        RATE * axes,
        STANDARD_GRAVITY * axes,
        lambda values: CHANGE * np.sign(values),
        lambda values: CHANGE * np.sign(values),
        np.full(6, TEMPERATURE_CHANGE),
    )
    gyro, accel = (_largest(part) for part in added(raw, {group: value}))
    meaning = group_named(group).meaning.partition(":")[0].partition(",")[0]
    condition = " and 10 K" if "temperature" in group else _MOVING.get(group, "")
    if gyro >= _SMALLEST_DEG_H * DEG_PER_HOUR:
        return [f"{group} ({meaning}): {gyro / DEG_PER_HOUR:.3g} deg/h at 1 g, 100 deg/s{condition}"]
    if accel >= _SMALLEST_MG * MG:
        return [f"{group} ({meaning}): {accel / MG:.3g} mg at 1 g{condition}"]
    return []


def _told(what: str, size: float, smallest: float, unit: str, more: str = "") -> list[str]:
    return [f"{what}: {size:.3g} {unit}{f', {more}' if more else ''}"] if size >= smallest else []


def _largest(values: Array) -> float:
    return float(np.abs(values).max())

"""The product's own steps of navigation, one by one, for tests that compare them with independent ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import groups_of, places_of
from kreisel.inertial.sensor_model import (
    SensorParameters,
    SizeEffect,
    correct_angular_rate,
    correct_specific_force,
)
from kreisel.inertial.strapdown import NOISE_STEP, InertialSignal, raw_readings, without_effects

from .kernel_parts import coefficients, composition, preintegration
from .kernel_parts.preintegration import Increments

Sensors = Mapping[str, Array]
"""Values of effects, flat, by group."""


@dataclass(frozen=True)
class SensorColumns:
    """Sensor parameters for many sigma points, as the kernels take them, and the matrices K of the first.

    rate, force, shared: (P, 3, m), (features, 3, m), (features, 3, M - m).
    """

    rate: Array
    force: Array
    shared: Array
    K_omega: Array
    K_a: Array

    @classmethod
    def stack(
        cls, form: SizeEffect, sets: Sequence[SensorParameters], turning: int = 1, applied: Sensors | None = None
    ) -> SensorColumns:
        """Return columns of parameter sets, of which the first `turning` have gyro parameters of their own.

        applied: effects by which the readings have been corrected; by default those of each set, so that none are left.
        """
        K_omega, k_w, K_a, k_a, arms = (
            np.stack([getattr(p, name) for p in sets], axis=-1)
            for name in ("K_omega", "k_w", "K_a", "k_a", "lever_arms")
        )
        left = [{} if applied is None else {g: v - applied[g] for g, v in p.effects.items()} for p in sets]
        w, a = (
            np.stack([_of_features(own, sensor) for own in left], axis=-1) for sensor in ("gyroscope", "accelerometer")
        )
        rate = coefficients.rate_coefficients(K_omega[..., :turning], k_w[0, :, :turning], w[..., :turning])
        parts = []
        for turns, chosen in ((rate, slice(0, turning)), (rate[..., :1], slice(turning, None))):
            accel = [part[..., chosen] for part in (K_a, k_a[0], arms, a)]
            parts.append(coefficients.force_coefficients(turns, *accel, printed=form is SizeEffect.FOX2005))
        return cls(rate, *parts, K_omega[..., 0].copy(), K_a[..., 0].copy())

    @classmethod
    def single(cls, p: SensorParameters, form: SizeEffect) -> SensorColumns:
        """Return one column, for readings that are corrected for its effects."""
        return cls.stack(form, [p])


def _of_features(values: Sensors, sensor: str) -> Array:
    """Return what each feature of a sensor's effects adds to the reading of each axis, (E, 3)."""
    places = places_of({g: v.size for g, v in values.items()}, sensor)
    own = np.concatenate([np.zeros(1), *(values[g] for g in groups_of(values, sensor))])
    return np.where(places < 0, 0.0, own[places + 1])


def corrected(
    t: Array, w: Array, a: Array, p: SensorParameters, alpha: Array, form: SizeEffect = SizeEffect.COMPLETED
) -> tuple[Array, Array]:
    """Return rate and specific force (n, 3) from raw readings, with all effects, for a known angular acceleration.

    The temperature is a second's number of K above that of the parameters.
    """
    rates, accelerations = without_effects(raw_readings(t, w, a, temperature_difference=t), p)
    omega = correct_angular_rate(rates, p)
    return omega, correct_specific_force(accelerations, omega, alpha, p, form)


class Increment(NamedTuple):
    """Motion between two samples, one column for each parameter set; its arrays along the way begin at sample `low`."""

    first: int
    last: int
    low: int
    duration: float
    motion: Increments


def preintegrate(signal: InertialSignal, first: int, last: int, columns: SensorColumns) -> Increment:
    """Return the motion from sample `first` to sample `last` for every column of parameters."""
    parts = columns.rate, columns.force, columns.shared
    motion = preintegration.preintegrate(signal.samples, first, last, *parts)
    low = preintegration.low_of(signal.samples, first, last)
    return Increment(first, last, low, float(signal.stamps[last] - signal.stamps[first]), motion)


def noise_covariance(signal: InertialSignal, step: Increment, columns: SensorColumns) -> Array:
    """Return the covariance (9, 9) of attitude, velocity and position caused by sensor noise.

    Uses the first column of an increment. Seen from the body's inertial attitude at its first sample; attitude errors
    as left perturbations there.
    """
    samples = step.last - step.first
    every = max(1, int(NOISE_STEP * samples / step.duration)) if step.duration > 0.0 else 1
    return preintegration.noise_covariance(
        signal.samples, step.first, step.last, every, step.motion, columns.K_omega, columns.K_a
    )


def navigate(
    signal: InertialSignal,
    parameters: SensorParameters,
    q: Array,
    v: Array,
    p: Array,
    gravity: Array,
    earth_rate: Array,
    *,
    form: SizeEffect = SizeEffect.COMPLETED,
    stride: int = 100,
) -> tuple[Array, Array, Array, Array]:
    """Return stamps, attitudes, velocities and positions of free inertial navigation in r.

    Parameters
    ----------
    q, v, p : (4,), (3,), (3,)
        Attitude q_rb, velocity and position at the first sample.
    gravity, earth_rate : (3,)
        In r, m/s^2 and rad/s.
    stride
        Samples between two results; results stand at every `stride`-th sample and at the last.
    """
    columns = SensorColumns.single(parameters, form)
    state = [np.array(part, dtype=float).reshape(-1, 1) for part in (q, v, p)]
    g, w = gravity.reshape(3, 1).astype(float), earth_rate.reshape(3, 1).astype(float)
    last_sample = signal.stamps.size - 1
    knots = [*range(0, last_sample, stride), last_sample]
    history = [[part[:, 0].copy() for part in state]]
    for first, last in pairwise(knots):
        step = preintegrate(signal, first, last, columns)
        state = [*composition.compose(step.duration, step.motion, g, w, *state)]
        history.append([part[:, 0].copy() for part in state])
    qs, vs, ps = (np.array(column) for column in zip(*history, strict=True))
    return signal.stamps[knots], qs, vs, ps

"""The product's own steps of navigation, one by one, for tests that compare them with independent ones."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kreisel._kernels import coefficients, composition, preintegration
from kreisel._kernels.preintegration import Increments
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import NOISE_STEP, InertialSignal


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
        cls, form: SizeEffect, K_omega: Array, k_w: Array, K_a: Array, k_a: Array, lever_arms: Array
    ) -> SensorColumns:
        """Return columns from parameters with sigma points last: the gyros' (…, m), the accelerometers' (…, M >= m)."""
        turning = K_omega.shape[-1]
        rate = coefficients.rate_coefficients(K_omega, k_w)
        parts = []
        for turns, chosen in ((rate, slice(0, turning)), (rate[..., :1], slice(turning, None))):
            accel = [part[..., chosen] for part in (K_a, k_a, lever_arms)]
            parts.append(coefficients.force_coefficients(turns, *accel, form.products, form.inside))
        return cls(rate, *parts, K_omega[..., 0].copy(), K_a[..., 0].copy())

    @classmethod
    def single(cls, p: SensorParameters, form: SizeEffect) -> SensorColumns:
        """Return one column."""
        parts = (p.K_omega, p.k_w, p.K_a, p.k_a, p.lever_arms)
        return cls.stack(form, *(part[..., None] for part in parts))


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

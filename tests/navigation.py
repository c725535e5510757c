"""The product's own steps of navigation, one by one, for tests that compare them with independent ones."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kreisel._kernels import coefficients, composition, preintegration, quadrature, sensor_noise
from kreisel._kernels.increments import Coefficients, Increments, Span
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import NOISE_STEP, InertialSignal


@dataclass(frozen=True)
class SensorColumns:
    """Sensor parameters for many sigma points, as the kernels take them, and the matrices K of the first."""

    coefficients: Coefficients
    K_omega: Array
    K_a: Array

    @classmethod
    def stack(
        cls, form: SizeEffect, K_omega: Array, k_w: Array, K_a: Array, k_a: Array, lever_arms: Array
    ) -> SensorColumns:
        """Return columns from parameters with sigma points last: the gyros' (…, m), the accelerometers' (…, M >= m)."""
        order, turning = k_w.shape[0], K_omega.shape[-1]
        rate = np.empty((1 + 3 * order, 3, turning))
        coefficients.rate_coefficients(K_omega, k_w, rate)
        features = coefficients.force_features(1 + 3 * order, order)
        parts = []
        for turns, chosen in ((rate, slice(0, turning)), (rate[..., :1].copy(), slice(turning, None))):
            accel = [np.ascontiguousarray(part[..., chosen]) for part in (K_a, k_a, lever_arms)]
            out = np.empty((features, 3, accel[0].shape[-1]))
            coefficients.force_coefficients(turns, accel[0], accel[1], accel[2], form.products, form.inside, out)
            parts.append(out)
        return cls(Coefficients(rate, *parts), K_omega[..., 0].copy(), K_a[..., 0].copy())

    @classmethod
    def single(cls, p: SensorParameters, form: SizeEffect) -> SensorColumns:
        """Return one column."""
        parts = (p.K_omega, p.k_w, p.K_a, p.k_a, p.lever_arms)
        return cls.stack(form, *(np.ascontiguousarray(part[..., None]) for part in parts))


class Increment(NamedTuple):
    """Motion between two samples, one column for each parameter set."""

    span: Span
    duration: float
    motion: Increments


def preintegrate(signal: InertialSignal, first: int, last: int, columns: SensorColumns) -> Increment:
    """Return the motion from sample `first` to sample `last` for every column of parameters."""
    m = columns.coefficients.force.shape[-1] + columns.coefficients.shared.shape[-1]
    base = signal.samples.base
    low, high = min(int(base[first]), last - 1), max(last, int(base[last - 1]) + quadrature.POINTS - 1)
    shapes = (4, m), *[(3, m)] * 4, (3, 3, m), (high - low + 1, 3), (high - low + 1, 4)
    span, motion = Span(first, last, low, high), Increments(*(np.empty(shape) for shape in shapes))
    preintegration.preintegrate(span, signal.samples, columns.coefficients, motion)
    return Increment(span, float(signal.stamps[last] - signal.stamps[first]), motion)


def noise_covariance(signal: InertialSignal, step: Increment, columns: SensorColumns) -> Array:
    """Return the covariance (9, 9) of attitude, velocity and position caused by sensor noise.

    Uses the first column of an increment. Seen from the body's inertial attitude at its first sample; attitude errors
    as left perturbations there.
    """
    Q = np.empty((9, 9))
    samples = step.span.last - step.span.first
    every = max(1, int(NOISE_STEP * samples / step.duration)) if step.duration > 0.0 else 1
    sensor_noise.noise_covariance(step.span, every, signal.samples, step.motion, columns.K_omega, columns.K_a, Q)
    return Q


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
        composition.compose(step.duration, np.zeros(1, dtype=np.int64), step.motion, g, w, *state)
        history.append([part[:, 0].copy() for part in state])
    qs, vs, ps = (np.array(column) for column in zip(*history, strict=True))
    return signal.stamps[knots], qs, vs, ps

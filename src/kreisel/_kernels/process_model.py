"""The process model of the cell: sigma points carried from one update to the next, and the noise on the way."""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels import coefficients, composition, preintegration, sensor_noise
from kreisel._kernels.arrays import Array, Indices, PreparedReadings
from kreisel._kernels.blocks import column_of, place, rows_from
from kreisel._kernels.cell import (
    ATTITUDE,
    PATH_ORIENTATION,
    PATH_POSITION,
    POSITION,
    VELOCITY,
    IntegratedMotion,
    Model,
    ParameterRows,
)
from kreisel._kernels.compilation import kernel, part_of_kernel
from kreisel._kernels.increments import Coefficients, Increments, Span
from kreisel._kernels.quadrature import POINTS


@kernel
def rows_of(rows: ParameterRows, points: Array, columns: Indices) -> Array:
    """Return some numbers of the model for `columns` (m,) of points (size, 2 n + 1), (e, m)."""
    out = np.empty((rows.source.size, columns.size))
    composition.gather(points, columns, rows.source, rows.known, out)
    return out


@kernel
def sensor_coefficients(model: Model, points: Array, rate: Array, force: Array, shared: Array) -> None:
    """Write the arrays of `increments.Coefficients` for sigma points (size, 2 n + 1)."""
    order, turning, sharing = model.order, model.turning.size, model.sharing.size
    gyro = rows_of(model.gyro, points, model.turning)
    coefficients.rate_coefficients(gyro[:9].reshape(3, 3, turning), gyro[9:].reshape(order, 3, turning), rate)
    alone = np.empty((rate.shape[0], 3, 1))
    for f in range(rate.shape[0]):
        for row in range(3):
            alone[f, row, 0] = rate[f, row, 0]
    own, others = rows_of(model.accel, points, model.turning), rows_of(model.accel, points, model.sharing)
    at = 9 + 3 * order
    coefficients.force_coefficients(
        rate, own[:9].reshape(3, 3, turning), own[9:at].reshape(order, 3, turning), own[at:].reshape(3, 3, turning),
        model.products, model.inside, force,
    )  # fmt: skip
    coefficients.force_coefficients(
        alone, others[:9].reshape(3, 3, sharing), others[9:at].reshape(order, 3, sharing),
        others[at:].reshape(3, 3, sharing), model.products, model.inside, shared,
    )  # fmt: skip


@part_of_kernel
def propagate(model: Model, signal: PreparedReadings, first: int, last: int, points: Array) -> IntegratedMotion:
    """Carry sigma points (size, 2 n + 1) from sample `first` to `last`, in place, and return the `IntegratedMotion`."""
    at = model.stored
    turning, sharing, sigma = model.turning.size, model.sharing.size, points.shape[1]
    P, M = 1 + 3 * model.order, turning + sharing
    features = coefficients.force_features(P, model.order)
    rate = np.empty((P, 3, turning))
    force, shared = np.empty((features, 3, turning)), np.empty((features, 3, sharing))
    sensor_coefficients(model, points, rate, force, shared)
    low, high = min(signal.base[first], last - 1), max(last, signal.base[last - 1] + POINTS - 1)
    span = Span(first, last, low, high)
    increments = Increments(
        np.empty((4, M)), np.empty((3, M)), np.empty((3, M)), np.empty((3, M)), np.empty((3, M)), np.empty((3, 3, M)),
        np.empty((high - low + 1, 3)), np.empty((high - low + 1, 4)),
    )  # fmt: skip
    preintegration.preintegrate(span, signal, Coefficients(rate, force, shared), increments)
    q, v, p = rows_from(points, at[ATTITUDE], 4), rows_from(points, at[VELOCITY], 3), rows_from(points, at[POSITION], 3)
    q_first = np.empty((4, sigma))
    place(q, 0, 0, q_first)
    around = rows_of(model.around, points, np.arange(sigma))
    gravity, earth_rate = np.empty((3, sigma)), np.empty((3, sigma))
    composition.environment(model.level, model.down, around[:4], around[4:6], around[9], around[6], gravity, earth_rate)
    duration = signal.stamps[last] - signal.stamps[first]
    composition.compose(duration, model.which, increments, gravity, earth_rate, q, v, p)

    taken = max(1, int(model.noise_step * (last - first) / duration)) if duration > 0.0 else 1
    K_omega, K_a = np.empty((3, 3)), np.empty((3, 3))
    for row in range(3):
        for axis in range(3):
            K_omega[row, axis] = rate[1 + axis, row, 0]
            K_a[row, axis] = force[P * (P + 1) // 2 + P - 1 + axis, row, 0]
    Q, noise = np.empty((9, 9)), np.empty((9, 9))
    sensor_noise.noise_covariance(span, taken, signal, increments, K_omega, K_a, Q)
    sensor_noise.navigation_noise(Q, column_of(q_first, 0), column_of(increments.dq, 0), noise)
    end = increments.omega_end, increments.alpha_end, increments.u_end
    return IntegratedMotion(q_first, end[0], end[1], end[2], gravity, earth_rate, around, noise)


@part_of_kernel
def process_noise(model: Model, navigation: Array, duration: float, points: Array) -> Array:
    """Return noise columns (c, k) of all that changes, and let coloured noise of the reference decay in the points.

    navigation (9, 9): `IntegratedMotion.noise`; points (size, 2 n + 1), changed in place.
    """
    at, rows = model.stored, 0
    for name in (PATH_POSITION, PATH_ORIENTATION):
        rows += 3 if at[name] >= 0 else 0
    out = np.zeros((rows + 9, rows + 9))
    place(navigation, rows, rows, out)
    row = 0
    for name in (PATH_POSITION, PATH_ORIENTATION):
        if at[name] >= 0:
            kept = math.exp(-duration / model.coloured[0])  # equation (15)
            for axis in range(3):
                for s in range(points.shape[1]):
                    points[at[name] + axis, s] *= kept
            fresh = model.coloured[1 + name - PATH_POSITION] * math.sqrt(1.0 - kept * kept)
            for axis in range(3):
                out[row + axis, row + axis] = fresh
            row += 3
    return out

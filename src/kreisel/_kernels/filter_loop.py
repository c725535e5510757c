"""The filter over many updates without leaving compiled code: predict, measure, update, record.

The recursion itself, which knows nothing of a cell, stands in `sigma_point_filter`; the cell's in `process_model` and
`measurement_model`.
"""

from __future__ import annotations

import math

import numpy as np

from kreisel._kernels import sigma_point_filter, triangular
from kreisel._kernels.arrays import Array, PreparedReadings
from kreisel._kernels.blocks import column_of, rows_from
from kreisel._kernels.cell import VELOCITY, Gate, Model, Record, Steps
from kreisel._kernels.compilation import kernel, part_of_kernel
from kreisel._kernels.measurement_model import measurement_noise, predict_measurement
from kreisel._kernels.process_model import process_noise, propagate


@kernel
def run(
    model: Model,
    signal: PreparedReadings,
    steps: Steps,
    begin: int,
    end: int,
    gate: Gate,
    belief: sigma_point_filter.Gaussian,
    record: Record,
) -> int:
    """Carry a belief over the updates from `begin` to `end`, in place.

    Returns
    -------
    int
        The update it stopped before: less than `end` if too many measurements were rejected in a row, or the
        state is no longer finite.
    """
    n, size, at = belief.upper.shape[0], belief.mean.size, model.stored
    points = np.empty((size, 2 * n + 1))
    for i in range(begin, end):
        first, last = steps.first[i], steps.last[i]
        duration = signal.stamps[last] - signal.stamps[first]
        for j in range(model.walking.size):
            triangular.inflate(belief.upper, model.walking[j], model.walk[j] * math.sqrt(duration))
        spread = model.weights[sigma_point_filter.SPREAD]
        sigma_point_filter.draw(model.parts, belief.mean, belief.upper, spread, points)
        motion = propagate(model, signal, first, last, points)
        noise = process_noise(model, motion.noise, duration, points)
        seen, seen_noise, innovation = predict_measurement(model, signal, steps, i, motion, points, noise)
        velocity, omega = column_of(rows_from(points, at[VELOCITY], 3), 0), column_of(motion.omega, 0)
        by_reference = measurement_noise(model, steps.at_standstill[i], steps.given, velocity, omega)
        predicted = sigma_point_filter.Predicted(points, noise, seen, seen_noise)
        bound = gate.bounds[innovation.size]
        done = sigma_point_filter.update(
            model.parts, model.tail, model.weights, belief, predicted, innovation, by_reference, bound
        )
        gate.rejected[0] = 0 if done.used else gate.rejected[0] + 1
        note(record, i, belief.mean, innovation, by_reference, done)
        sigma_point_filter.deviations(belief.upper, i, record.deviation)
        if not math.isfinite(done.nis) or gate.rejected[0] >= gate.most:
            return i + 1
    return end


@part_of_kernel
def note(
    record: Record, i: int, mean: Array, innovation: Array, measurement_factor: Array, done: sigma_point_filter.Updated
) -> None:
    """Write into the record what update i leaves: mean (size,), innovation (m,), measurement_factor (m, e)."""
    n, m = done.gain.shape
    record.used[i] = done.used
    for j in range(mean.size):
        record.mean[i, j] = mean[j]
    for r in range(m):
        record.innovation[i, r] = innovation[r]
        record.whitened[i, r] = done.whitened[r]
        for j in range(m):
            record.factor[i, r, j] = done.factor[r, j]
            variance = 0.0
            for e in range(measurement_factor.shape[1]):
                variance += measurement_factor[r, e] * measurement_factor[j, e]
            record.noise[i, r, j] = variance
        for j in range(3):
            record.gain[i, j, r] = done.gain[n - 9 + j, r]
            record.gain[i, 3 + j, r] = done.gain[n - 3 + j, r]

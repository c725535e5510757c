"""Free inertial navigation by the product's own steps, for tests that close the loop with an independent motion."""

from itertools import pairwise

import numpy as np

from kreisel._kernels import composition
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import InertialSignal, SensorColumns, preintegrate


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
        composition.compose(step.duration, np.zeros(1, dtype=np.int64), step.arrays, g, w, *state)
        history.append([part[:, 0].copy() for part in state])
    qs, vs, ps = (np.array(column) for column in zip(*history, strict=True))
    return signal.stamps[knots], qs, vs, ps

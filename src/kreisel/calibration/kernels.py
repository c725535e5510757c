"""Every kernel made ready before the work begins, so that compiling shows as a step of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kreisel._kernels import attitude, composition, rotation
from kreisel.estimation import filter as spkf
from kreisel.estimation.filter import triangularise
from kreisel.estimation.sigma_points import weights
from kreisel.estimation.state import Part, StateLayout
from kreisel.geometry.rotation import Array
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.strapdown import InertialSignal, SensorColumns, navigate, noise_covariance, preintegrate, prepare


class _Still:
    """A transition in which nothing moves."""

    def propagate(self, points: Array) -> Array:
        return points

    def process_noise(self) -> Array:
        return np.eye(3)

    def observe(self, points: Array) -> tuple[Array, Array]:
        return points[:3] - points[:3, :1], np.zeros(3)


def _filter_step() -> None:
    layout = StateLayout([Part("held", 3), Part("turn", 3, rotation=True)])
    belief = spkf.Belief(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.eye(6))
    step = spkf.predict(layout, belief, _Still(), weights("central-difference", 6), np.eye(3), 3)
    belief = spkf.update(layout, step)
    spkf.widen(layout, belief, "held", 1.0)


def _share_path(signal: InertialSignal, one: SensorColumns) -> None:
    columns = SensorColumns(one.rate, np.repeat(one.force, 2, axis=-1), one.K_omega, one.K_a)
    preintegrate(signal, 2, 4, columns)


def compile_kernels(progress: Callable[[float], None] | None = None) -> None:
    """Compile every kernel, or load it from the cache, by small problems; seconds the first time.

    Parameters
    ----------
    progress
        Called with the share done.
    """
    ideal = SensorParameters.ideal()
    level = np.array([1.0, 0.0, 0.0, 0.0])
    one, vector, zero = level[:, None].copy(), np.zeros((3, 1)), np.zeros(1, dtype=np.int64)
    columns = SensorColumns.single(ideal, SizeEffect.COMPLETED)
    signal = prepare(np.arange(12.0), np.zeros((12, 3)), np.zeros((12, 3)))
    steps: list[Callable[[], object]] = [
        lambda: navigate(signal, ideal, level, np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)),
        lambda: _share_path(signal, columns),
        lambda: noise_covariance(signal, 2, 4, preintegrate(signal, 2, 4, columns), columns),
        lambda: composition.navigation_noise(np.eye(9), level, level, np.empty((9, 9))),
        lambda: composition.gather(one, zero, zero, np.zeros(1), np.empty((1, 1))),
        lambda: composition.environment(0.0, 0.0, one, np.zeros((2, 1)), np.zeros(1), vector.copy(), vector.copy()),
        lambda: composition.pose_at(
            np.zeros(1), 1.0, 1.0, zero, zero, one, vector, vector, np.zeros((3, 3, 1)), vector, vector, one, vector,
            vector, one.copy(), vector.copy(),
        ),
        lambda: rotation.plus(one, np.zeros((3, 1)), one.copy()),
        lambda: rotation.minus(one, one, np.zeros((3, 1))),
        lambda: attitude.accumulate(np.zeros((2, 3)), np.tile(level, (3, 1))),
        lambda: triangularise(np.eye(2)),
        _filter_step,
    ]  # fmt: skip
    for i, step in enumerate(steps):
        step()
        if progress is not None:
            progress((i + 1) / len(steps))

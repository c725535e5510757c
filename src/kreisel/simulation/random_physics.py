"""Errors that are on no list: random smooth functions of what sensors, reference, arm and clock go through.

A function is a sum of random waves over one or several quantities, each in units of its own spread (random Fourier
features of a smooth Gaussian process, Rahimi and Recht 2007). Everything is taken out of it that the usual model has,
so that the parameters have one true value: over the recording a sensor's function is orthogonal to a constant, to
rates, their products and derivatives, and to accelerations, a reference's to what another tool point or frame would do.
What depends on time or the past is a drift beside these, which keeps its chance correlation with the motion, as a real
one does.
Sizes are spread evenly in their logarithm, up to what data sheets of the grade, and of arms and cameras, state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, exp, matrix, multiply
from kreisel.inertial.noise_figures import Grade
from kreisel.inertial.sensor_model import linear_columns
from kreisel.simulation.cell_settings import Unlisted
from kreisel.simulation.shaped_errors import of_poses, of_readings
from kreisel.units import STANDARD_GRAVITY

_WAVES = 12
"""Waves in a function: enough that it looks like no single one of them."""

_SMALLEST = 0.03
"""Share of the largest size that a size may have."""

_POSITION = {"robot": 2e-3, "mocap": 1.5e-3}
"""m; largest rms of a reference's position error on its path (ISO 9283 path accuracy; bent camera volumes)."""

_ORIENTATION = {"robot": 1e-3, "mocap": 3e-3}
"""rad; the same for orientations."""

_JOINT = 3e-4
"""rad; largest rms of a joint's transmission error (harmonic and cycloidal gears: one to a few arc minutes peak)."""

_SLOW = 16
"""Half waves of a drift over a recording: more than the seven of the fastest wave (three deviations from the mean)."""

_DEPENDENT = 1e-6
"""Share of the largest singular value below which columns are sums of others."""

_HARMONICS = 60
"""Highest order of a gear's error in its joint's angle."""

_CLOCK = 2e-3
"""s; largest rms of a clock's random error."""

_LAG = (5.0, 60.0)
"""s; memory of a sensor that depends on what happened before."""


@dataclass(frozen=True)
class RandomPhysics:
    """Functions of one cell; each is a random stream and is made where its quantities are known.

    Attributes
    ----------
    gyro, accel, reference, joints, clock
        Random streams of the functions, one each.
    size
        Factor on all sizes.
    shapes, of_shapes
        Sizes of errors of known shape, and their random stream.
    jacobian
        From joint angles (n, joints) to the pose's change for a unit of each, (n, 6, joints); see
        `kinematics.Derivatives`.
    """

    gyro: tuple[np.random.Generator, ...]
    accel: tuple[np.random.Generator, ...]
    reference: tuple[np.random.Generator, ...]
    joints: tuple[np.random.Generator, ...]
    clock: tuple[np.random.Generator, ...]
    size: float
    shapes: Unlisted
    of_shapes: np.random.Generator
    jacobian: Callable[[Array], Array]

    @classmethod
    def of(cls, settings: Unlisted, rng: np.random.Generator, jacobian: Callable[[Array], Array]) -> RandomPhysics:
        """Return the functions that a cell has."""
        gyro, accel, reference, joints, clock = (
            tuple(own.spawn(count))
            for own, count in zip(
                rng.spawn(5),
                (settings.gyro, settings.accel, settings.reference, settings.joints, settings.clock),
                strict=True,
            )
        )
        return cls(gyro, accel, reference, joints, clock, settings.size, settings, rng.spawn(1)[0], jacobian)

    def readings(self, grade: Grade, t: Array, rates: Array, accelerations: Array) -> tuple[Array, Array]:
        """Return what is added to ideal raw rates and accelerations (n, 3) at times t (n,)."""
        shaped = of_readings(self.shapes, self.of_shapes.spawn(1)[0], t, rates, accelerations)
        if not self.gyro and not self.accel and not np.any(shaped):
            return np.zeros_like(rates), np.zeros_like(accelerations)
        # what offsets, matrices, sensitivity to acceleration and lever arms can imitate
        linear = _Usual(linear_columns(rates, accelerations, np.gradient(rates, t, axis=0)), t)
        out = []
        for streams, own, size, shape in (
            (self.gyro, rates, grade.gyro_scale_sd * _rms(rates), shaped[0]),
            (self.accel, accelerations, grade.accel_scale_sd * STANDARD_GRAVITY, shaped[1]),
        ):
            total = linear.without(shape)
            for rng in streams:
                chosen, drifts = _of_sensor(rng, t, own, rates, accelerations)
                value = linear.without(_waves(rng, chosen, own.shape[1]), drifts=drifts)
                total += _sized(rng, value, self.size * size)
            out.append(total)
        return out[0], out[1]

    def poses(self, kind: str, t: Array, p: Array, q: Array, angles: Array) -> tuple[Array, Array]:
        """Return reported positions (n, 3) and quaternions (n, 4) with the errors of reference and joints."""
        C = matrix(q)
        # as another tool point, frame or scale would
        frames = _Usual(np.hstack([np.ones((t.size, 1)), C.reshape(-1, 9), p]), t)
        shaped = of_poses(self.shapes, self.of_shapes.spawn(1)[0], t, p)
        if np.any(shaped):
            shaped = frames.without(shaped)
            p, q = p + shaped[:, :3], multiply(exp(shaped[:, 3:]), q)
        for rng in self.reference:
            quantities = [p, C[:, :, 0], C[:, :, 2], t[:, None]]
            some = _some(rng, len(quantities))
            value = _waves(rng, np.hstack([quantities[k] for k in some]), 6)
            value = frames.without(value, drifts=len(quantities) - 1 in some)
            p = p + _sized(rng, value[:, :3], self.size * _POSITION[kind])
            q = multiply(q, exp(_sized(rng, value[:, 3:], self.size * _ORIENTATION[kind])))
        for rng in self.joints if angles.shape[1] else ():
            orders = rng.integers(1, _HARMONICS, (3, angles.shape[1]))
            waves = np.sin(orders * angles[:, None] + rng.uniform(0.0, 2.0 * np.pi, orders.shape)).sum(axis=1)
            error = _sized(rng, waves * rng.uniform(0.0, 1.0, angles.shape[1]), self.size * _JOINT)
            moved = np.einsum("nij,nj->ni", self.jacobian(angles), error)
            p, q = p + moved[:, :3], multiply(q, exp(moved[:, 3:]))
        return p, q

    def lateness(self, t: Array) -> Array:
        """Return by how much later than they say poses are taken, (n,), s."""
        out = np.zeros(t.size)
        for rng in self.clock:
            out += _sized(rng, _waves(rng, t[:, None], 1), self.size * _CLOCK)[:, 0]
        return out


class _Usual:
    """What the usual model has over a recording, to be taken out of functions."""

    def __init__(self, columns: Array, t: Array) -> None:
        """Take columns (n, k) of the usual model at times t (n,)."""
        self._columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        self._t = t

    def without(self, value: Array, *, drifts: bool = False) -> Array:
        """Return a function (n, j) without the share that the usual model has in it.

        drifts: it depends on time or the past, and the share is that beside a drift. Otherwise an offset that drifts
        would be one minus what readings are by chance like it, which no device has.
        """
        columns = self._columns
        if drifts:
            turned = np.pi * (self._t - self._t[0]) / max(float(np.ptp(self._t)), 1e-9)
            slow = np.linalg.qr(np.cos(turned[:, None] * np.arange(_SLOW + 1)))[0]
            columns = columns - slow @ (slow.T @ columns)
        return np.asarray(value - self._columns @ np.linalg.lstsq(columns, value, rcond=_DEPENDENT)[0])


def _of_sensor(
    rng: np.random.Generator, t: Array, own: Array, rates: Array, accelerations: Array
) -> tuple[Array, bool]:
    """Return the quantities that a sensor's error depends on, (n, k), and whether time or the past are among them."""
    memory = np.exp(rng.uniform(*np.log(_LAG)))
    quantities: list[Callable[[], Array]] = [
        lambda: own,
        lambda: rates,
        lambda: accelerations,
        lambda: np.gradient(own, t, axis=0),
        lambda: _remembered(np.abs(own), t, memory),
        lambda: t[:, None],
    ]
    chosen = _some(rng, len(quantities))
    return np.hstack([quantities[k]() for k in chosen]), max(chosen) >= len(quantities) - 2


def _some(rng: np.random.Generator, count: int) -> list[int]:
    """Return one or two of the numbers below `count`, at random."""
    return list(rng.choice(count, size=int(rng.integers(1, 3)), replace=False))


def _waves(rng: np.random.Generator, quantities: Array, columns: int) -> Array:
    """Return random smooth functions (n, columns) of quantities (n, k)."""
    spread = np.std(quantities, axis=0)
    z = (quantities - quantities.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    waves = rng.normal(size=(z.shape[1], _WAVES)) * rng.uniform(0.3, 2.0) / np.sqrt(z.shape[1])
    carried = np.cos(z @ waves + rng.uniform(0.0, 2.0 * np.pi, _WAVES))
    return np.asarray(carried @ rng.normal(size=(_WAVES, columns)))


def _sized(rng: np.random.Generator, value: Array, largest: float) -> Array:
    """Return values (n, k) without their mean, and with a random rms up to the largest."""
    value = value - value.mean(axis=0)
    size = largest * np.exp(rng.uniform(np.log(_SMALLEST), 0.0))
    rms = _rms(value)
    return np.asarray(value * (size / rms)) if rms > 0.0 else value


def _remembered(values: Array, t: Array, time: float) -> Array:
    """Return what is left of values (n, k) that fade with a time constant."""
    block = max(1, round(0.1 * t.size / max(t[-1] - t[0], 1e-9)))
    ends = np.arange(0, t.size, block)
    means = np.add.reduceat(values, ends, axis=0) / np.diff(np.append(ends, t.size))[:, None]
    keep, out = np.exp(-0.1 / time), np.empty_like(means)
    state = np.zeros(values.shape[1])
    for i, mean in enumerate(means):
        state = keep * state + (1.0 - keep) * mean
        out[i] = state
    return np.column_stack([np.interp(np.arange(t.size), ends, column) for column in out.T])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))

"""The motion that a calibrated IMU shows, and what errors of its calibration do to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.correction import Block, corrected
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.slopes import LocalCubics

_STEP = 1e-5
"""SI; step of the difference quotients by the parameters. Chosen: the motion is linear or bilinear in them, so that a
quotient errs by 1e-5 of what a unit of another one does; rounding is 1e-11."""

_PARTS, _LENGTH = 32, 256
"""Parts of a recording, and samples of each, that show what errors of a calibration do. Chosen: 8,000 samples give
second moments of the motion to two per cent, and deviations need no more."""

_MEAN = 0.04
"""Seconds over which motion and readings are averaged. Chosen: an arm's motion changes little in less, and noise of the
angular acceleration, which pulls lever arms together, falls with the cube of it."""


@dataclass(frozen=True)
class BodyMotion:
    """Motion of the body b, at n times.

    Attributes
    ----------
    seconds : (n,)
    rates, angular_accelerations, forces : (n, 3)
        Against inertial space, rad/s and rad/s^2; specific force at the origin of b, m/s^2.
    cubics
        By which values are differentiated at these times.
    """

    seconds: Array
    rates: Array
    angular_accelerations: Array
    forces: Array
    cubics: LocalCubics

    @cached_property
    def field(self) -> Array:
        """See `grown_by`."""
        return grown_by(self.rates, self.angular_accelerations)

    @classmethod
    def of(cls, raw: Block, sensors: SensorParameters) -> BodyMotion:
        """Return the motion that raw readings show with parameters."""
        seen = corrected(raw, sensors, SizeEffect.COMPLETED)
        return cls(raw.stamps, seen.rates, raw.cubics.slopes(seen.rates), seen.forces, raw.cubics)


@dataclass(frozen=True)
class MeanMotion:
    """Means of the motion over rows of some samples each: what readings without effects are linear in.

    Attributes
    ----------
    width
        Samples of a row.
    seconds : (m,)
    rates, forces : (m, 3)
    field : (m, 3, 3)
        [alpha x] + [omega x]^2.
    rate_slopes, force_slopes, field_slopes
        Their time derivatives.
    force_curvatures : (m, 3)
        Second derivatives of the forces.
    """

    width: int
    seconds: Array
    rates: Array
    forces: Array
    field: Array
    rate_slopes: Array
    force_slopes: Array
    field_slopes: Array
    force_curvatures: Array

    @classmethod
    def of(cls, motion: BodyMotion) -> MeanMotion:
        """Return the means of a motion."""
        width = max(1, round(_MEAN / float(np.median(np.diff(motion.seconds)))))
        field, slopes = motion.field, motion.cubics.slopes
        whole = (
            motion.seconds, motion.rates, motion.forces, field, motion.angular_accelerations, slopes(motion.forces),
            slopes(field.reshape(-1, 9)).reshape(-1, 3, 3), motion.cubics.curvatures(motion.forces),
        )  # fmt: skip
        return cls(width, *(averaged(part, width) for part in whole))

    def joined(self, count: int) -> MeanMotion:
        """Return the means of groups of `count` rows."""
        whole = (getattr(self, part.name) for part in fields(self) if part.name != "width")
        return MeanMotion(self.width * count, *(averaged(part, count) for part in whole))

    @property
    def row(self) -> float:
        """Seconds of a row."""
        return float(np.median(np.diff(self.seconds)))


def grown_by(rates: Array, alpha: Array) -> Array:
    """Return [alpha x] + [omega x]^2, (n, 3, 3), 1/s^2: by how much the force grows with the distance."""
    square = np.sum(rates**2, axis=1)
    out = rates[:, :, None] * rates[:, None, :]
    for k, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
        out[:, k, k] -= square
        out[:, row, column] += alpha[:, k]
        out[:, column, row] -= alpha[:, k]
    return np.asarray(out)


def averaged(values: Array, width: int) -> Array:
    """Return means (n / width, …) over rows of so many samples (n, …); a last row that is not whole is left out."""
    n = len(values) // width
    return np.asarray(values[: n * width].reshape(n, width, *values.shape[1:]).mean(axis=1))


@dataclass(frozen=True)
class MotionErrors:
    """What errors of a calibration do to the motion that it shows, in some of the rows of `MeanMotion`.

    Attributes
    ----------
    rows : (m,)
    rates, forces, field : (m, 3, p), (m, 3, p), (m, 3, 3, p)
        Changes for a unit of each parameter.
    """

    rows: Indices
    rates: Array
    forces: Array
    field: Array

    @classmethod
    def of(cls, raw: Block, moved: Callable[[Array], SensorParameters], count: int, width: int) -> MotionErrors:
        """Return the changes.

        Parameters
        ----------
        moved
            Returns the parameters moved by changes (count,) of the estimated ones.
        width
            Samples of a row.
        """
        rows = _excerpt(len(raw) // width, max(1, _LENGTH // width))
        samples = (rows[:, None] * width + np.arange(width)).ravel()
        part = Block(
            raw.stamps[samples], raw.rates[samples], raw.forces[samples],
            None if raw.temperature_difference is None else raw.temperature_difference[samples],
        )  # fmt: skip
        columns, unmoved = [], _means(part, moved(np.zeros(count)), width)
        for unit in np.eye(count):
            high = _means(part, moved(_STEP * unit), width)
            columns.append([(a - b) / _STEP for a, b in zip(high, unmoved, strict=True)])
        return cls(rows, *(np.stack([column[k] for column in columns], axis=-1) for k in range(3)))


def _means(raw: Block, sensors: SensorParameters, width: int) -> tuple[Array, Array, Array]:
    """Return the means of rates, forces and the field that raw readings show."""
    motion = BodyMotion.of(raw, sensors)
    return averaged(motion.rates, width), averaged(motion.forces, width), averaged(motion.field, width)


def _excerpt(n: int, length: int) -> Indices:
    """Return rows of parts spread evenly over n."""
    if n <= _PARTS * length:
        return np.arange(n)
    starts = np.round(np.linspace(0, n - length, _PARTS)).astype(int)
    return np.unique((starts[:, None] + np.arange(length)).ravel())

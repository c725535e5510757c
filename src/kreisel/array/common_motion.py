"""The motion that a calibrated IMU shows, and what errors of its calibration do to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.correction import Block, corrected
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.slopes import LocalCubics, local_cubics, usual_interval

_STEP = 1e-5
"""SI; step of the difference quotients by the parameters. Chosen: they are linear or bilinear; rounding is 1e-11."""

_PARTS, _LENGTH = 48, 400
"""Parts of a recording, and samples of each, that show what errors of a calibration do. Chosen: 20,000 samples give
second moments of the motion to a per cent, and deviations need no more."""


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

    @classmethod
    def of(cls, raw: Block, sensors: SensorParameters) -> BodyMotion:
        """Return the motion that raw readings show with parameters."""
        seen = corrected(raw, sensors, SizeEffect.COMPLETED)
        cubics = local_cubics(raw.stamps, usual_interval(raw.stamps))
        return cls(raw.stamps, seen.rates, cubics.slopes(seen.rates), seen.forces, cubics)


@dataclass(frozen=True)
class MotionErrors:
    """What errors of a calibration do to the motion that it shows, at some of the times.

    Attributes
    ----------
    samples : (m,)
    rates, angular_accelerations, forces : (m, 3, p)
        Changes for a unit of each parameter.
    """

    samples: Indices
    rates: Array
    angular_accelerations: Array
    forces: Array

    @classmethod
    def of(cls, raw: Block, moved: Callable[[Array], SensorParameters], count: int) -> MotionErrors:
        """Return the changes; `moved` returns the parameters moved by changes (count,) of the estimated ones."""
        samples = _excerpt(len(raw))
        part = Block(
            raw.stamps[samples], raw.rates[samples], raw.forces[samples],
            None if raw.temperature_difference is None else raw.temperature_difference[samples],
        )  # fmt: skip
        columns = []
        for unit in np.eye(count):
            high, low = (BodyMotion.of(part, moved(sign * _STEP * unit)) for sign in (1.0, -1.0))
            columns.append(
                [
                    (getattr(high, name) - getattr(low, name)) / (2.0 * _STEP)
                    for name in ("rates", "angular_accelerations", "forces")
                ]
            )
        return cls(samples, *(np.stack([column[k] for column in columns], axis=2) for k in range(3)))


def _excerpt(n: int) -> Indices:
    """Return samples of parts spread evenly over n."""
    if n <= _PARTS * _LENGTH:
        return np.arange(n)
    starts = np.round(np.linspace(0, n - _LENGTH, _PARTS)).astype(int)
    return np.asarray((starts[:, None] + np.arange(_LENGTH)).ravel())

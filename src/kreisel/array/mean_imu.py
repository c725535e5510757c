"""The mean of several IMUs on one body, in the axes of one of them: a less noisy IMU that anything can calibrate.

Each unit's readings are brought to those of the base unit by a fixed matrix and offset, found by least squares in which
the units' places are free. The matrices need not be exact: small errors of theirs are a scale, offsets and positions of
the mean's own. Large ones would not be: each unit brings forces of another place with it. With weights by the units'
noise the mean holds all that their readings say of the common motion, and its noise is independent of that of a unit's
difference from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.array.common_motion import averaged, grown_by
from kreisel.array.resampled import Resampled, white_noise
from kreisel.errors import SynchronizationError
from kreisel.geometry.rotation import Array, Mask
from kreisel.inertial.slopes import local_cubics, usual_interval
from kreisel.preparation.imu_noise import noise_stated, rounding_step
from kreisel.recording.location import is_table
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.synchronization.clock import Clock

MIN_EXPLAINED = 0.8
"""Share of the base unit's change of rate that another unit's readings explain, below which it does not move with it.
Chosen: noise of the cheapest gyros at the slowest motion of an arm takes a tenth of it."""


_ROW = 0.1
"""Seconds over which readings are averaged before one unit's are fitted to another's. Chosen: noise and vibration of
what explains would pull matrices towards zero, and an arm's motion changes little in less."""

_FEW = 20
"""Rows that are enough to compare units by. Chosen: ten unknowns, twice."""

_FAR = 0.3
"""m; between units, as a prior. Chosen: the length of a tray."""


@dataclass(frozen=True)
class Aligned:
    """How a unit's readings are brought to those of the base unit.

    Attributes
    ----------
    name, clock
        The unit, and its clock against that of the base unit.
    gyro, accel : (3, 4)
        Matrix and offset.
    noise : (2,)
        Noise density of rates and accelerations so brought, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), rms over the axes;
        with that of coarse rounding, whose error is taken to last as long as a row.
    share
        Of the base unit's times, that at which there are readings.
    """

    name: str
    clock: Clock
    gyro: Array
    accel: Array
    noise: Array
    share: float

    def brought(self, readings: Resampled) -> tuple[Array, Array]:
        """Return rates and accelerations (n, 3) in the axes of the base unit."""
        return (
            readings.rates @ self.gyro[:, :3].T + self.gyro[:, 3],
            readings.forces @ self.accel[:, :3].T + self.accel[:, 3],
        )


@dataclass(frozen=True)
class BaseRows:
    """Means of the base unit's readings over rows of some samples, which other units are compared with.

    Attributes
    ----------
    width
        Samples of a row.
    known : (n,)
        Which samples there are.
    rates, forces : (m, 3)
    field : (m, 3, 3)
        [alpha x] + [omega x]^2, 1/s^2: by how much the force grows with the distance.
    """

    width: int
    known: Mask
    rates: Array
    forces: Array
    field: Array

    @classmethod
    def of(cls, readings: Resampled, seconds: Array) -> BaseRows:
        """Return the means of readings at times (n,)."""
        interval = usual_interval(seconds)
        width = max(1, round(_ROW / interval))
        slopes = local_cubics(seconds, interval).slopes(readings.rates)
        rates, forces, alpha = (averaged(values, width) for values in (readings.rates, readings.forces, slopes))
        return cls(width, readings.known, rates, forces, grown_by(rates, alpha))


def align(name: str, imu: ImuSamples, clock: Clock, readings: Resampled, base: BaseRows) -> Aligned:
    """Return how a unit's readings are brought to the base unit's.

    readings: those of `imu` at the times of the base unit's.

    Raises
    ------
    SynchronizationError
        If they explain too little of them.
    """
    known = averaged((readings.known & base.known).astype(float), base.width) == 1.0
    both = known.copy()  # a slope next to what is not known is none
    both[1:] &= known[:-1]
    both[:-1] &= known[1:]
    if int(both.sum()) < _FEW:
        raise SynchronizationError("has hardly any readings at the times of the other units")
    rates, forces = (averaged(values, base.width)[both] for values in (readings.rates, readings.forces))
    gyro, explained = _linear(rates, base.rates[both])
    if not explained >= MIN_EXPLAINED:
        raise SynchronizationError(
            f"its rates explain {100.0 * max(explained, 0.0):.0f} % of the other units' changes of rate, expected "
            f"{100.0 * MIN_EXPLAINED:.0f} % or more: it did not move with them, or its readings are wrong"
        )
    accel = _placed(forces, base.forces[both], base.field[both])
    squared = [
        imu.interval * np.mean((part[:, :3] @ white_noise(own)) ** 2) + _ROW * rounding_step(own) ** 2 / 12.0
        for part, own in ((gyro, imu.rates), (accel, imu.accelerations))
    ]
    return Aligned(name, clock, gyro, accel, np.sqrt(squared), float(np.mean(readings.known)))


def _linear(x: Array, y: Array) -> tuple[Array, float]:
    """Return matrix and offset (3, 4) that bring x to y (n, 3), and the share of y's variance they explain."""
    centre_x, centre_y = x.mean(axis=0), y.mean(axis=0)
    u, v = x - centre_x, y - centre_y
    matrix = np.linalg.lstsq(u.T @ u, u.T @ v, rcond=None)[0].T
    left = float(np.mean((v - u @ matrix.T) ** 2)) / max(float(np.mean(v**2)), 1e-300)
    return np.column_stack([matrix, centre_y - matrix @ centre_x]), 1.0 - left


def _placed(x: Array, y: Array, field: Array) -> Array:
    """Return matrix and offset (3, 4) that bring forces x (n, 3) to those of another place, y; field: (n, 3, 3).

    The distance is free for each axis of y, within some decimetres.
    """
    out, one = _linear(x, y)[0], np.ones((len(x), 1))
    noise = np.mean((y - x @ out[:, :3].T - out[:, 3]) ** 2, axis=0)
    for j in range(3):
        columns = np.hstack([x, one, field[:, j]])
        A, b = columns.T @ columns, columns.T @ y[:, j]
        A[4:, 4:] += noise[j] / _FAR**2 * np.eye(3)
        out[j] = np.linalg.lstsq(A, b, rcond=None)[0][:4]
    return out


class MeanImu:
    """Sums of the readings of units that are brought to a base unit; units can be taken out again."""

    def __init__(self, times: Array) -> None:
        n = times.size
        self._sums = np.zeros((n, 6))
        self._weights = np.zeros((n, 2))
        self._warmth = np.zeros(n)
        self._warm: Array = np.zeros(n)
        self._units = self._thermometers = 0.0
        self._squares = np.zeros(2)
        self._whole = np.zeros(2)

    def add(self, unit: Aligned, readings: Resampled, sign: float = 1.0) -> None:
        """Add a unit; a sign of -1 takes it out."""
        weights = sign * unit.noise**-2.0
        own = readings.known[:, None] * weights
        rates, forces = unit.brought(readings)
        self._sums += np.hstack([own[:, :1] * rates, own[:, 1:] * forces])
        self._weights += own
        self._squares += sign * weights**2
        self._whole += weights
        self._units += sign
        if readings.temperature is not None:
            self._warmth += sign * readings.known * readings.temperature
            self._warm += sign * readings.known
            self._thermometers += sign

    @property
    def gain(self) -> Array:
        """How many equal units have the noise of the mean, of gyros and of accelerometers, (2,)."""
        return np.asarray(self._whole**2 / self._squares)

    def recording(self, base: Recording) -> Recording:
        """Return the recording of the mean while all units read, with the reference of the base unit's."""
        known: Mask = np.all(self._weights > 1e-9 * self._whole, axis=1)
        whole = np.flatnonzero((self._weights > (1.0 - 1e-9) * self._whole).all(axis=1))
        if whole.size:
            known[: whole[0]] = known[whole[-1] + 1 :] = False
        rates, forces = (self._sums[known, 3 * k : 3 * k + 3] / self._weights[known, k, None] for k in (0, 1))
        warm = self._warm[known]
        all_warm = self._units == self._thermometers > 0.0 and (warm > 0.0).all()  # coefficients are of all units
        temperature = self._warmth[known] / warm if all_warm else None
        own = base.imu.source
        source = own.parent.parent / "mean" / "data.csv" if is_table(own) else base.path / "mean"
        imu = ImuSamples(base.imu.stamps_ns[known], rates, forces, source, temperature=temperature)
        return replace(base, imu=imu, settings=_settings(base, self.gain), sha256=None)


def _settings(base: Recording, gain: Array) -> RecordingSettings:
    """Return settings with the noise that is stated of one unit, less by the root of how many there are."""
    stated = noise_stated(base)
    if stated is None:
        return base.settings
    share = dict(zip(("gyro", "accel"), gain**-0.5, strict=True))
    names = {"density": "noise_density", "walk": "random_walk"}
    own = {
        f"{sensor}_{names[what]}": value * share[sensor]
        for key, value in stated[1].items()
        for sensor, what in [key.split("_")]
        if value
    }
    return base.settings.model_copy(update={"imu": base.settings.imu.model_copy(update=own)})


def gains_of(units: Sequence[Aligned]) -> Array:
    """Return the share of each unit in the mean, (units, 2): of gyros and accelerometers."""
    weights = np.array([unit.noise**-2.0 for unit in units])
    return np.asarray(weights / weights.sum(axis=0))

"""The mean of several IMUs on one body, in the axes of one of them: a less noisy IMU that anything can calibrate.

Each unit's readings are brought to those of the base unit by a fixed matrix and offset, found by least squares. The
matrices need not be exact: whatever they are, their sum is an instrument with a scale, offsets and positions of its
own. With weights by the units' noise the mean holds all that their readings say of the common motion, and its noise is
independent of that of a unit's difference from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.array.resampled import Resampled, white_noise
from kreisel.errors import SynchronizationError
from kreisel.geometry.rotation import Array, Mask
from kreisel.preparation.imu_noise import noise_stated
from kreisel.recording.location import is_table
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.recording.recording_settings import RecordingSettings
from kreisel.synchronization.clock import Clock

MIN_EXPLAINED = 0.8
"""Share of the base unit's change of rate that another unit's readings explain, below which it does not move with it.
Chosen: noise of the cheapest gyros at the slowest motion of an arm takes a tenth of it."""


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
        Noise density of rates and accelerations so brought, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), rms over the axes.
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


def align(name: str, imu: ImuSamples, clock: Clock, readings: Resampled, base: Resampled) -> Aligned:
    """Return how a unit's readings are brought to the base unit's.

    readings: those of `imu` at the times of the base unit's.

    Raises
    ------
    SynchronizationError
        If they explain too little of them.
    """
    both = readings.known & base.known
    if int(both.sum()) < 100:
        raise SynchronizationError("has hardly any readings at the times of the other units")
    gyro, explained = _linear(readings.rates[both], base.rates[both])
    if not explained >= MIN_EXPLAINED:
        raise SynchronizationError(
            f"its rates explain {100.0 * max(explained, 0.0):.0f} % of the other units' changes of rate, expected "
            f"{100.0 * MIN_EXPLAINED:.0f} % or more: it did not move with them, or its readings are wrong"
        )
    accel, _ = _linear(readings.forces[both], base.forces[both])
    noise = [
        float(np.sqrt(imu.interval * np.mean((part[:, :3] @ white_noise(own)) ** 2)))
        for part, own in ((gyro, imu.rates), (accel, imu.accelerations))
    ]
    return Aligned(name, clock, gyro, accel, np.array(noise), float(np.mean(readings.known)))


def _linear(x: Array, y: Array) -> tuple[Array, float]:
    """Return matrix and offset (3, 4) that bring x to y (n, 3), and the share of y's variance they explain."""
    centre_x, centre_y = x.mean(axis=0), y.mean(axis=0)
    u, v = x - centre_x, y - centre_y
    matrix = np.linalg.lstsq(u.T @ u, u.T @ v, rcond=None)[0].T
    left = float(np.mean((v - u @ matrix.T) ** 2)) / max(float(np.mean(v**2)), 1e-300)
    return np.column_stack([matrix, centre_y - matrix @ centre_x]), 1.0 - left


class MeanImu:
    """Sums of the readings of units that are brought to a base unit; units can be taken out again."""

    def __init__(self, times: Array) -> None:
        n = times.size
        self._sums = np.zeros((n, 6))
        self._weights = np.zeros((n, 2))
        self._warmth = np.zeros(n)
        self._warm: Array = np.zeros(n)
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
        if readings.temperature is not None:
            self._warmth += sign * readings.known * readings.temperature
            self._warm += sign * readings.known

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
        temperature = self._warmth[known] / warm if warm.size and (warm > 0.0).all() else None
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

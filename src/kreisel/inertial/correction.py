"""A calibration applied to readings: all of them at once, or block by block as they come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.inertial.effects import RawReadings, reaches_further
from kreisel.inertial.sensor_model import (
    SensorParameters,
    SizeEffect,
    correct_angular_rate,
    correct_specific_force,
)
from kreisel.inertial.slopes import REACH, SAMPLES, USUAL, LocalCubics, local_cubics, run_starts, usual_interval
from kreisel.inertial.strapdown import without_effects


@dataclass(frozen=True)
class Block:
    """Consecutive samples: stamps (n,), s; two triads (n, 3), rad/s and m/s^2; temperature differences (n,), K.

    Only raw ones have the latter. The triads are raw rates and accelerations, or angular rate and specific force.
    """

    stamps: Array
    rates: Array
    forces: Array
    temperature_difference: Array | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.stamps.size)

    @cached_property
    def cubics(self) -> LocalCubics:
        """By which values are differentiated at these samples, whose usual interval is their own."""
        return local_cubics(self.stamps, usual_interval(self.stamps))

    def part(self, start: int, stop: int | None = None) -> Block:
        """Return the samples from `start` to before `stop`."""
        own = slice(start, stop)
        temperature_difference = None if self.temperature_difference is None else self.temperature_difference[own]
        return Block(self.stamps[own], self.rates[own], self.forces[own], temperature_difference)

    def followed_by(self, other: Block) -> Block:
        """Return these samples and those of the other."""
        warm = self.temperature_difference is not None and other.temperature_difference is not None
        return Block(
            np.concatenate([self.stamps, other.stamps]),
            np.concatenate([self.rates, other.rates]),
            np.concatenate([self.forces, other.forces]),
            np.concatenate([self.temperature_difference, other.temperature_difference]) if warm else None,
        )


def corrected(raw: Block, sensors: SensorParameters, form: SizeEffect, usual: float | None = None) -> Block:
    """Return angular rate and specific force of raw readings.

    Parameters
    ----------
    usual
        Usual interval, s, by which gaps are found; that of the samples by default.

    Notes
    -----
    Equations (1) and (2). Derivatives are those of `slopes.local_cubics`: of the corrected angular rate for the lever
    arms, of the raw accelerations for their delay and smoothing.
    """
    cubics = raw.cubics if usual is None else local_cubics(raw.stamps, usual)
    temperature_difference = np.zeros(len(raw)) if raw.temperature_difference is None else raw.temperature_difference
    readings = RawReadings(raw.stamps, raw.rates, raw.forces, cubics.slopes, cubics.curvatures, temperature_difference)
    rates, accelerations = without_effects(readings, sensors)
    omega = correct_angular_rate(rates, sensors)
    return Block(raw.stamps, omega, correct_specific_force(accelerations, omega, cubics.slopes(omega), sensors, form))


class Correction:
    """Readings corrected block by block; the samples returned are the same, however the stream is split.

    Parameters
    ----------
    sensors, form
        As for `corrected`.

    Notes
    -----
    A sample is returned when the three after it have come; the first ones of a run, when seven have: three more where
    derivatives of the gyros' readings correct them. Nothing is returned until `slopes.USUAL` intervals have shown the
    usual one.
    """

    def __init__(self, sensors: SensorParameters, form: SizeEffect) -> None:
        self._later = REACH if reaches_further(sensors.others) else 0
        self._sensors, self._form = sensors, form
        self._kept: Block | None = None
        self._returned = 0  # of those kept
        self._usual: float | None = None

    def push(self, raw: Block) -> Block:
        """Return the corrected samples that are complete after more raw ones, in their order; there may be none."""
        self._kept = raw if self._kept is None else self._kept.followed_by(raw)
        if self._usual is None and len(self._kept) > USUAL:
            self._usual = usual_interval(self._kept.stamps)
        return self._until(0 if self._usual is None else _complete(self._kept.stamps, self._usual, self._later))

    def close(self) -> Block:
        """Return the remaining samples; their derivatives are those at the end of the last cubic."""
        return self._until(0 if self._kept is None else len(self._kept))

    def _until(self, end: int) -> Block:
        """Return the samples not yet returned up to before `end`, and keep what the next ones need."""
        nothing = Block(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
        if self._kept is None or end <= self._returned:
            return nothing
        out = corrected(self._kept, self._sensors, self._form, self._usual).part(self._returned, end)
        begin = max(end - SAMPLES - self._later, 0)
        self._kept, self._returned = self._kept.part(begin), end - begin
        return out


def _complete(stamps: Array, usual: float, later: int) -> int:
    """Return how many samples have cubics that no later one changes; later: samples that the fitted values need."""
    starts = run_starts(stamps, usual)
    if starts.size and stamps.size < starts[-1] + SAMPLES + later:
        return int(starts[-1])
    return int(stamps.size) - REACH - later

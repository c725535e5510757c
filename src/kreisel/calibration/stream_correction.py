"""A calibration applied to readings as they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kreisel.calibration.array_checks import check_ascending, check_nanoseconds, temperature_difference_of, triads
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array
from kreisel.inertial.correction import Block, Correction
from kreisel.inertial.counts import Counts
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect
from kreisel.inertial.slopes import USUAL

Corrected = tuple[NDArray[np.int64], Array, Array]


class CorrectedStream:
    """Readings corrected block by block, as `Calibration.correct` does it with all of them.

    Parameters
    ----------
    sensors, form, temperature_c
        Of the calibration; the temperature that the parameters belong to, degrees Celsius, where they need it.
    check
        Whether stamps must come at a rate that IMUs have.

    Notes
    -----
    A sample is returned when the three after it have come, the first ones after a hundred; see `inertial.correction`.
    """

    def __init__(
        self, sensors: SensorParameters, form: SizeEffect, temperature_c: float | None, counts: Counts | None = None,
        *, check: bool = True,
    ) -> None:  # fmt: skip
        self._sensors, self._temperature, self._counts = sensors, temperature_c, counts
        self._check = check
        self._correction = Correction(sensors, form)
        self._waiting: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._first: int | None = None
        self._last: NDArray[np.int64] = self._waiting

    def push(
        self, rates: ArrayLike, accelerations: ArrayLike, stamps_ns: ArrayLike, temperatures: ArrayLike | None = None
    ) -> Corrected:
        """Return stamps (n,), angular rate and specific force (n, 3) of the samples that are complete now.

        Parameters
        ----------
        rates, accelerations : (m, 3)
            Raw readings, rad/s and m/s^2, or counts where those were calibrated.
        stamps_ns : (m,)
            Nanoseconds, ascending, also from block to block.
        temperatures : (m,)
            Of the sensor, degrees Celsius; needed where the calibration has temperature coefficients.

        Raises
        ------
        RecordingError
            If an argument has another shape or is not finite, or if the stamps do not ascend; nothing is taken then.
        """
        raw, a = triads(rates, "rates", 0), triads(accelerations, "accelerations", 0)
        if len(a) != len(raw):
            raise RecordingError(f"accelerations: got the shape {a.shape}, expected {raw.shape} as of rates")
        if self._counts is not None:
            raw, a = self._counts.in_si(raw, a)
        stamps = np.asarray(stamps_ns)
        if stamps.dtype.kind not in "iu" or stamps.shape != (len(raw),):
            raise RecordingError(
                f"stamps_ns: got {stamps.dtype} of the shape {stamps.shape}, expected nanoseconds as integers, "
                f"({len(raw)},), one for each reading"
            )
        stamps = stamps.astype(np.int64)
        check_ascending(np.concatenate([self._last, stamps]), "stamps_ns")
        waiting = np.concatenate([self._waiting, stamps])
        if self._check and waiting.size > USUAL:  # none has been returned before
            check_nanoseconds(waiting, "stamps_ns")
        temperature_difference = temperature_difference_of(temperatures, len(raw), self._sensors, self._temperature)
        if not len(raw):
            return self._stamped(self._correction.push(Block(np.zeros(0), raw, a, temperature_difference)))
        self._first = int(stamps[0]) if self._first is None else self._first
        self._check = self._check and waiting.size <= USUAL
        self._last, self._waiting = stamps[-1:], waiting
        return self._stamped(
            self._correction.push(Block((stamps - self._first) * 1e-9, raw, a, temperature_difference))
        )

    def close(self) -> Corrected:
        """Return the remaining samples, after the last block."""
        if self._check:
            check_nanoseconds(self._waiting, "stamps_ns")
        return self._stamped(self._correction.close())

    def _stamped(self, done: Block) -> Corrected:
        stamps, self._waiting = self._waiting[: len(done)], self._waiting[len(done) :]
        return stamps, done.rates, done.forces

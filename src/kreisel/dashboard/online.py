"""Calibration while recording: the same calibration, of what there is by now, again and again.

At the end it is that of the whole recording, to the last digit. It takes a set share of one processor: the longer
one takes, the longer the pause to the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.acquisition.tail import Tail
from kreisel.calibration.calibrate import run_calibration
from kreisel.calibration.result import Calibration
from kreisel.calibration.settings import CalibrationSettings
from kreisel.errors import KreiselError
from kreisel.geometry.rotation import Array

SHARE = 0.2
"""Share of one processor's time that calibrating may take."""

PAUSE = 2.0
"""Seconds at least between two calibrations."""


@dataclass(frozen=True)
class Estimate:
    """What is known after so many seconds of recording.

    Attributes
    ----------
    seconds
        Of IMU readings.
    names, values, deviations : (n,)
        Parameters by the paths they have in the result; empty where nothing could be estimated.
    said
        Why there is no estimate, what is wrong with it, or that it is accepted.
    """

    seconds: float
    names: tuple[str, ...]
    values: Array
    deviations: Array
    accepted: bool
    said: str
    calibration: Calibration | None = None


class Online:
    """Calibrations of a recording as it grows."""

    def __init__(
        self, tail: Tail, settings: CalibrationSettings | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.tail, self._settings, self._clock = tail, settings or CalibrationSettings(), clock
        self._next = -np.inf
        self._done = False

    def step(self) -> Estimate | None:
        """Return a new estimate if it is time for one; always a last one once the recording has ended."""
        now = self._clock()
        if self._done or (now < self._next and not self.tail.ended):
            return None
        self._done = self.tail.ended
        estimate = self._estimate()
        self._next = now + max(PAUSE, (self._clock() - now) / SHARE)
        return estimate

    def _estimate(self) -> Estimate:
        try:
            recording = self.tail.recording()
        except KreiselError as error:
            return _nothing(0.0, error)
        seconds = float(recording.imu.seconds[-1])
        try:
            outcome = run_calibration(recording, self._settings)
        except KreiselError as error:
            return _nothing(seconds, error)
        found = outcome.calibration
        n = len(found.names)
        accepted = outcome.verdict.accepted
        said = "accepted" if accepted else "; ".join(outcome.verdict.reasons)
        row = found.estimates[-1]
        return Estimate(seconds, tuple(found.names), row[1 : 1 + n], row[1 + n :], accepted, said, found)


def _nothing(seconds: float, error: KreiselError) -> Estimate:
    return Estimate(seconds, (), np.zeros(0), np.zeros(0), False, f"nothing yet: {error}")

"""Calibration while recording: the same calibration, of what there is by now, again and again.

At the end it is that of the whole recording, to the last digit. It takes a set share of one processor: the longer
one takes, the longer the pause to the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from kreisel.acquisition.tail import Tail
from kreisel.calibration.calibrate import run_calibration
from kreisel.dashboard.live_estimate import LiveEstimate
from kreisel.errors import KreiselError
from kreisel.model.settings import CalibrationSettings

SHARE = 0.2
"""Share of one processor's time that calibrating may take."""

PAUSE = 2.0
"""Seconds at least between two calibrations."""


class Online:
    """Calibrations of a recording as it grows."""

    def __init__(
        self, tail: Tail, settings: CalibrationSettings | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.tail, self._settings, self._clock = tail, settings or CalibrationSettings(), clock
        self._next = -np.inf
        self._done = False

    def step(self) -> LiveEstimate | None:
        """Return a new estimate if it is time for one; always a last one once the recording has ended."""
        now = self._clock()
        if self._done or (now < self._next and not self.tail.ended):
            return None
        self._done = self.tail.ended
        estimate = self._estimate()
        self._next = now + max(PAUSE, (self._clock() - now) / SHARE)
        return estimate

    def look(self) -> LiveEstimate | None:
        """Read what has been written since, and return a new estimate if it is time for one; see `step`.

        Raises
        ------
        RecordingError
            If the recording cannot be read.
        """
        self.tail.read()
        return self.step() if self.tail.begun else None

    def _estimate(self) -> LiveEstimate:
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
        return LiveEstimate(seconds, tuple(found.names), row[1 : 1 + n], row[1 + n :], accepted, said, found)


class Targets:
    """Whether a recording that is being made tells enough: standard deviations, by group of parameters.

    Attributes
    ----------
    reached
        Whether an accepted calibration had them all below their targets; never without targets.
    over
        Set it to end `look`.
    """

    def __init__(self, path: Path, targets: dict[str, float], say: Callable[[str], None]) -> None:
        self.reached = self.over = False
        self._path = path
        self._targets, self._say = targets, say

    def look(self) -> None:
        """Look again and again; for a thread of its own."""
        online = Online(Tail(self._path))
        while not self.over:
            with suppress(KreiselError):
                found = online.look()
                if found is not None and found.names:
                    self._weigh(found)
            time.sleep(0.3)

    def _weigh(self, found: LiveEstimate) -> None:
        worst = {
            group: max(d for n, d in zip(found.names, found.deviations, strict=True) if n.startswith(group))
            for group in self._targets
            if any(name.startswith(group) for name in found.names)
        }
        known = "".join(f"; {group} ±{deviation:.3g}" for group, deviation in worst.items())
        self._say(f"after {found.seconds:.0f} s: {found.said}{known}")
        below = [worst.get(group, np.inf) <= target for group, target in self._targets.items()]
        self.reached = self.reached or (found.accepted and bool(below) and all(below))


def _nothing(seconds: float, error: KreiselError) -> LiveEstimate:
    return LiveEstimate(seconds, (), np.zeros(0), np.zeros(0), False, f"nothing yet: {error}")

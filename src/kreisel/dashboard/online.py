"""Calibration while recording: the ordinary calibration, repeated with the data recorded so far.

The last one equals the calibration of the complete recording, to the last digit. Calibrations take a fixed share of
one processor: the longer one takes, the longer the pause before the next. They rest from the moment on at which a
bounded tail is full until the recording has ended.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from kreisel.acquisition.tail import Tail
from kreisel.calibration.calibrate import run_calibration
from kreisel.dashboard.live_estimate import LiveEstimate
from kreisel.dashboard.live_goals import write_goals
from kreisel.errors import ExcitationError, KreiselError
from kreisel.formats.loading import load
from kreisel.model.calibration_settings import CalibrationSettings

SHARE = 0.2
"""Share of one processor's time for calibrations."""

PAUSE = 2.0
"""Shortest pause between two calibrations, s."""

GROWN = 1.5
"""Factor by which a recording must have grown before a complaint about its columns or units that lasts is shown."""


_RESTS = "the next estimate comes when the recording ends, which is long now"


class Online:
    """Calibrations of a recording as it grows."""

    def __init__(
        self, tail: Tail, settings: CalibrationSettings | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.tail, self._settings, self._clock = tail, settings or CalibrationSettings(), clock
        self._next = -np.inf
        self._done = self._rests = False
        self._accused: tuple[str, float] | None = None

    def step(self) -> LiveEstimate | None:
        """Return a new estimate if one is due; always a last one when the recording has ended."""
        now = self._clock()
        if self._done or ((now < self._next or self._rests) and not self.tail.ended):
            return None
        self._rests = self.tail.full
        self._done = self.tail.ended
        estimate = self._estimate()
        if self._rests and not self._done:
            estimate = replace(estimate, summary=f"{estimate.summary}; {_RESTS}")
        self._next = now + max(PAUSE, (self._clock() - now) / SHARE)
        return estimate

    def look(self) -> LiveEstimate | None:
        """Read newly written data, and return a new estimate if one is due; see `step`.

        Raises
        ------
        RecordingError
            If the recording cannot be read.
        """
        self.tail.read()
        return self.step() if self.tail.begun else None

    def _estimate(self) -> LiveEstimate:
        try:
            ended = self.tail.ended and not self.tail.whole
            recording = load(self.tail.file) if ended else self.tail.recording()
        except KreiselError as error:
            return _nothing(0.0, error)
        seconds = float(recording.imu.seconds[-1])
        try:
            outcome = run_calibration(recording, self._settings)
        except KreiselError as error:
            return self._not_yet(seconds, error)
        self._accused = None
        found = outcome.calibration
        n = len(found.names)
        accepted = outcome.verdict.accepted
        text = "accepted" if accepted else "; ".join(outcome.verdict.reasons)
        row = found.estimates[-1]
        return LiveEstimate(seconds, tuple(found.names), row[1 : 1 + n], row[1 + n :], accepted, text, found)

    def _not_yet(self, seconds: float, error: KreiselError) -> LiveEstimate:
        """Return that there is no estimate, with the reason once it has lasted while the recording grew.

        A few seconds of motion along few axes can look like exchanged columns or wrong signs.
        """
        what = re.sub(r"[-+.\d]+", "", str(error))
        if self._accused is None or self._accused[0] != what:
            self._accused = (what, seconds)
        lasted = self.tail.ended or seconds > GROWN * self._accused[1]
        if lasted or isinstance(error, ExcitationError):
            return _nothing(seconds, error)
        return LiveEstimate(
            seconds, (), np.zeros(0), np.zeros(0), False, "nothing yet: too little of the motion to tell anything"
        )


class Targets:
    """Check whether the accuracy of a live calibration is sufficient: standard deviations, by parameter group.

    Attributes
    ----------
    reached
        Whether an accepted calibration had all deviations below their targets; False without targets.
    over
        Set to True to end `look`.
    """

    def __init__(self, path: Path, targets: dict[str, float], say: Callable[[str], None]) -> None:
        self.reached = self.over = False
        self._path, self._goals_written = path, False
        self._targets, self._say = targets, say

    def look(self) -> None:
        """Calibrate repeatedly until `over` is set; to be run in a separate thread. The targets go to the page."""
        online = Online(Tail(self._path, bounded=True))
        while not self.over:
            with suppress(KreiselError):
                found = online.look()
                if not self._goals_written and online.tail.begun:
                    self._goals_written = write_goals(self._path, self._targets)
                if found is not None and found.names:
                    self._compare(found)
            time.sleep(0.3)

    def _compare(self, found: LiveEstimate) -> None:
        worst = {
            group: max(d for n, d in zip(found.names, found.deviations, strict=True) if n.startswith(group))
            for group in self._targets
            if any(name.startswith(group) for name in found.names)
        }
        known = "".join(f"; {group} ±{deviation:.3g}" for group, deviation in worst.items())
        self._say(f"after {found.seconds:.0f} s: {found.summary}{known}")
        below = [worst.get(group, np.inf) <= target for group, target in self._targets.items()]
        self.reached = self.reached or (found.accepted and bool(below) and all(below))


def _nothing(seconds: float, error: KreiselError) -> LiveEstimate:
    return LiveEstimate(seconds, (), np.zeros(0), np.zeros(0), False, f"nothing yet: {error}")

"""What to do next while a device is calibrated by hand: hold it still, turn it to another attitude, or stop.

The next attitude is the one that says most: of faces, edges and corners of a cube the one that nobody has had first,
and from the first estimate on the one where gravity's length is predicted worst, or the turn to which is about the axis
of the gyros that is known worst.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kreisel.errors import KreiselError, RecordingError
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import Recording
from kreisel.static.rest_search import find_rests, held_still
from kreisel.static.static_result import StaticOutcome, calibrate_static

HOLD = 3.0
"""Seconds that a standstill is asked to last. Chosen: one is used from 1.2 s on, and hands begin late."""

ENOUGH, FIRST, TRIED = 18, 9, 6
"""Attitudes after which an accepted result is enough where no accuracy is asked for, of the first estimate, and from
which on readings that nothing fits are noticed."""

_FAILURES = 2
"""Attempts at an estimate that fail one after the other, after which readings are taken to be wrong."""

_APART, _SAME = np.radians(20.0), np.radians(12.0)
"""Angles between attitudes that count as different, and as the same one again."""

_NARROW = np.radians(35.0)
"""Largest angle from the mean of all attitudes up to which they are said to be alike."""

CANDIDATES: Array = np.array(
    sorted((v for v in itertools.product((1.0, 0.0, -1.0), repeat=3) if any(v)), key=lambda v: sum(map(abs, v)))
)
CANDIDATES /= np.linalg.norm(CANDIDATES, axis=1, keepdims=True)
"""Directions in the device that may be up, (26, 3): its faces, edges and corners, in this order."""


@dataclass(frozen=True)
class Advice:
    """What to do now.

    Attributes
    ----------
    step
        `hold`, `turn` or `done`.
    text
        What to do, one sentence.
    held
        Seconds that the device has stood still by now.
    up : (3,)
        What is up now, by the accelerometers, of unit length.
    had : (M, 3)
        What was up at the standstills so far.
    wanted : (3,) or None
        What is to be up next.
    known
        Standard deviations by group of parameters, the worst of each, and targets; empty before the first estimate.
    note
        What to know besides.
    """

    step: str
    text: str
    held: float
    up: Array
    had: Array
    wanted: Array | None = None
    known: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """The advice as an object for the page."""
        return {
            "kind": "advice", "step": self.step, "text": self.text, "held": round(self.held, 1), "hold": HOLD,
            "up": np.round(self.up, 4).tolist(), "had": np.round(self.had, 4).tolist(),
            "wanted": None if self.wanted is None else self.wanted.tolist(),
            "known": {g: float(f"{sd:.3g}") if np.isfinite(sd) else None for g, sd in self.known.items()},
            "note": self.note,
        }  # fmt: skip


class Guide:
    """Advice from the readings so far.

    Parameters
    ----------
    targets
        Standard deviations to be reached, by group of parameters, SI.
    gravity
        Local gravity, m/s^2, if it is stated on the command line.

    Attributes
    ----------
    outcome
        The last calibration; None before the first.
    """

    def __init__(self, targets: Mapping[str, float] | None = None, gravity: float | None = None) -> None:
        self._targets, self._gravity = dict(targets or {}), gravity
        self.outcome: StaticOutcome | None = None
        self._counted = self._failed = 0
        self._said = ""
        self._asked: tuple[int, Array] | None = None

    def look(self, recording: Recording) -> Advice:
        """Return what to do now."""
        imu = recording.imu
        held = held_still(imu)
        up = _up(imu.accelerations[-max(1, round(0.3 / imu.interval)) :])
        try:
            rests = find_rests(imu)
        except RecordingError:
            return self._first(held, up)
        had = _directions(rests.forces)
        if rests.count >= TRIED and rests.count > self._counted:
            self._counted = rests.count
            self._estimate(recording)
        if self._failed >= _FAILURES:
            return Advice("turn", f"Stop, for more attitudes do not help: {self._said}", held, up, had)
        if self._reached(rests.count):
            asked = "it is as accurate as asked for" if self._targets else "these attitudes show every parameter"
            return Advice("done", f"Enough: {asked}.", held, up, had, known=self._known())
        again = len(had) > 1 and bool((_angles(had[:-1], had[-1]) < _SAME).any())
        if held < HOLD:
            # a standstill that has begun is among those found once it is long enough
            begun = held > 0.5
            wanted = None if begun else self._next(had, up)
            text = f"Hold still: {held:.1f} s of {HOLD:.0f} s." if begun else _ask(wanted)
            return Advice("hold" if begun else "turn", text, held, up, had, wanted, self._known(), self._note(had))
        wanted = self._next(had, up)
        note = "This attitude is one that you have had." if again else self._note(had)
        return Advice("turn", _ask(wanted), held, up, had, wanted, self._known(), note)

    def _first(self, held: float, up: Array) -> Advice:
        text = f"Hold still: {held:.1f} s of {HOLD:.0f} s." if held > 0.5 else "Lay the device down."
        return Advice("hold", text, held, up, np.zeros((0, 3)))

    def _estimate(self, recording: Recording) -> None:
        try:
            found = calibrate_static(recording, gravity=self._gravity)
        except KreiselError as error:
            self._failed += 1
            self._said = error.message if isinstance(error, RecordingError) else str(error)
            return
        self._failed = 0
        if self._counted >= FIRST:
            self.outcome = found
            self._said = "" if found.calibration.accepted else found.calibration.verdict.reasons[0]

    def _reached(self, count: int) -> bool:
        if self.outcome is None or not self.outcome.calibration.accepted:
            return False
        if not self._targets:
            return count >= ENOUGH and not self.outcome.calibration.verdict.unobservable
        known = self._known()
        return all(known.get(group, np.inf) <= target for group, target in self._targets.items())

    def _known(self) -> dict[str, float]:
        """Return the worst deviation of each group that is asked for, or of the usual ones."""
        if self.outcome is None:
            return {}
        calibration = self.outcome.calibration
        deviation = np.sqrt(np.diag(calibration.covariance))
        groups = self._targets or (
            "gyroscope.cross_coupling", "gyroscope.offset", "accelerometer.cross_coupling", "accelerometer.offset",
        )  # fmt: skip
        return {
            group: max((float(d) for n, d in zip(calibration.names, deviation, strict=True) if n.startswith(group)),
                       default=np.inf)
            for group in groups
        }  # fmt: skip

    def _note(self, had: Array) -> str:
        if len(had) >= FIRST and float(_angles(had, _up(had)).max()) < _NARROW:
            return (
                "All attitudes so far are nearly alike. Scale factors and offsets of the accelerometers stay unknown "
                "then, however long it takes: turn the device over."
            )
        return self._said

    def _next(self, had: Array, up: Array) -> Array:
        """Return the direction that is to be up next, (3,): the same one until the device has stood still again."""
        if self._asked is None or self._asked[0] != len(had):
            self._asked = len(had), self._most_telling(had, up)
        return self._asked[1]

    def _most_telling(self, had: Array, up: Array) -> Array:
        free = np.array([float(_angles(had, c).min()) > _APART for c in CANDIDATES])
        if not free.any():
            free = _angles(CANDIDATES, up) > _APART
        candidates = CANDIDATES[free]
        if self.outcome is None:
            return np.asarray(candidates[0])
        return np.asarray(candidates[int(np.argmax(_worth(self.outcome, candidates, up)))])


def _worth(outcome: StaticOutcome, candidates: Array, up: Array) -> Array:
    """Return what each direction would say, (k,), in deviations of use."""
    calibration, layout = outcome.calibration, outcome.found.problem.layout
    P, gravity = calibration.covariance, outcome.found.parameters.gravity
    K, k = layout["accel_cross_coupling"], layout["accel_offset"]
    places = [(p // 3, p % 3) for p in layout.present("accel_cross_coupling").tolist()]
    # how the length of the force errs by the parameters
    rows = np.zeros((len(candidates), P.shape[0]))
    rows[:, K] = np.stack([gravity * candidates[:, i] * candidates[:, j] for i, j in places], axis=1)
    rows[:, k] = candidates
    length = np.sqrt(np.einsum("ki,ij,kj->k", rows, P, rows)) / gravity
    sd = np.sqrt(np.diag(P))[layout["gyro_cross_coupling"]].reshape(3, 3)
    axes = np.cross(up, candidates)
    turn = np.abs(axes) @ np.sqrt(np.mean(sd**2, axis=0))
    return np.asarray(length + turn)


def _ask(wanted: Array | None) -> str:
    if wanted is None:
        return "Turn the device to another attitude."
    words = [f"{axis} {'up' if v > 0.0 else 'down'}" for axis, v in zip("xyz", wanted, strict=True) if abs(v) > 1e-3]
    how = ("", " on its face", " on an edge, at 45 deg", " on a corner")[len(words)]
    return f"Turn it gently{how}: {' and '.join(words)}. Then hold still."


def _directions(forces: Array) -> Array:
    return np.asarray(forces / np.maximum(np.linalg.norm(forces, axis=1, keepdims=True), 1e-9))


def _up(values: Array) -> Array:
    """Return the mean direction of vectors (n, 3)."""
    return np.asarray(_directions(values.mean(axis=0)[None])[0])


def _angles(directions: Array, one: Array) -> Array:
    return np.asarray(np.arccos(np.clip(directions @ one, -1.0, 1.0)))

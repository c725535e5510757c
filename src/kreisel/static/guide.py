"""What to do next while a device is calibrated by hand: hold it still, turn it to another attitude, or stop.

The next attitude is the one that says most: of faces, edges and corners of a cube the one that nobody has had first,
and from the first estimate on the one where gravity's length is predicted worst, or the turn to which is about the axis
of the gyros that is known worst.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from kreisel.errors import KreiselError, RecordingError, SettingsError
from kreisel.geometry.rotation import Array, lengths
from kreisel.progress import Progress
from kreisel.recording.recording import ImuSamples, Recording
from kreisel.static.guide_plans import CANDIDATES, FACES, FLAT, PLANS, SAME, Seen, angles, directions, seen
from kreisel.static.rest_search import find_rests, held_still
from kreisel.static.rests import Rests
from kreisel.static.static_result import CLIPPED, StaticOutcome

HOLD = 3.0
"""Seconds that a standstill is asked to last. Chosen: one is used from 1.2 s on, and hands begin late."""

FIRST, TRIED = 9, 6
"""Standstills of the first estimate, and from which on readings that nothing fits are noticed."""

_FAILURES = 2
"""Attempts at an estimate that fail one after the other, after which readings are taken to be wrong."""

_NARROW = np.radians(35.0)
"""Largest angle from the mean of all attitudes up to which they are said to be alike."""

_FAR = 2.0
"""Times of an accuracy asked for, up to which it is not said that attitudes do not lead to it. Chosen: terms that data
do not decide halve until they do."""

_FROZEN = 10.0
"""Seconds for which all readings must be the same until that is said. Chosen: those of few digits may be, at rest."""

_SAG, _LAST = 5e-3, 3
"""rad: median turn within the last standstills, and their number, from which on it is said. Chosen: it costs accuracy,
and a hand that is supported turns less."""

_HELD, _SWAYS, _TURNS = 5.0, 0.05, 0.3
"""s; rad and rad/s: a device that keeps its attitude for so long within such an angle, and turns slower, is held, but
not still. Chosen: a hand that puts it down takes less long."""

_ASKEW = np.radians(40.0)
"""Largest angle from a face up to which an attitude that is not on it was meant to be. Chosen: an edge is at 45 deg."""

_WORDS = {
    "gyroscope.cross_coupling": "the gyros' scale factors and axes", "gyroscope.offset": "the gyros' offsets",
    "accelerometer.cross_coupling": "the accelerometers' scale factors and axes",
    "accelerometer.offset": "the accelerometers' offsets",
}  # fmt: skip
"""Groups of parameters in words."""

_MANY = 60
"""Further standstills from which on it is said how many an accuracy takes: as long as all before, and more."""

USUAL = (
    "gyroscope.cross_coupling", "gyroscope.offset", "accelerometer.cross_coupling", "accelerometer.offset",
)  # fmt: skip
"""Groups of parameters that are always estimated."""


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


class Estimator(Protocol):
    """Calibrates a recording."""

    def __call__(self, recording: Recording, /, *, progress: Progress | None = None) -> StaticOutcome:
        """Return the calibration."""


class Guide:
    """Advice from the readings so far.

    `look` is quick. An estimate takes seconds: where one is `due`, call `estimate`, on another thread if you like.

    Parameters
    ----------
    calibrate
        By which estimates are made.
    targets
        Standard deviations to be reached, by group of parameters, SI.
    method
        The one that is stated, of `guide_plans.PLANS`.
    only
        The sensor that is asked for.

    Attributes
    ----------
    outcome
        The last calibration; None before the first.

    Raises
    ------
    SettingsError
        For a method that takes more than an IMU, or a target of parameters that are not estimated.
    """

    def __init__(
        self, calibrate: Estimator, targets: Mapping[str, float] | None = None, *, method: str | None = None,
        only: str | None = None,
    ) -> None:  # fmt: skip
        if method not in PLANS:
            raise SettingsError(f"--live does not guide the method {method}: record it with its table, then calibrate")
        self._usual = tuple(group for group in USUAL if only is None or group.startswith(only))
        for group in targets or ():
            if group not in self._usual:
                raise SettingsError(f"--until {group}: not estimated here; expected one of {', '.join(self._usual)}")
        self._calibrate, self._targets, self._only = calibrate, dict(targets or {}), only
        self._plan = PLANS[method]
        self.outcome: StaticOutcome | None = None
        self._seen = Seen(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
        self._counted = self._failed = 0
        self._said = ""
        self._asked: tuple[int, tuple[Array | None, str]] | None = None

    @property
    def _any_attitude(self) -> bool:
        """Whether the method takes any attitudes."""
        return self._plan.method in (None, "multi-position")

    @property
    def due(self) -> bool:
        """Whether there are standstills of which there is no estimate yet, and enough of them."""
        return TRIED <= len(self._seen.had) > self._counted and self._plan.complete(self._seen)

    def look(self, recording: Recording) -> Advice:
        """Return what to do now."""
        imu = recording.imu
        held = held_still(imu)
        up = _mean(imu.accelerations[-max(1, round(0.3 / imu.interval)) :])
        try:
            rests = find_rests(imu)
        except RecordingError:
            return _first(held, up)
        self._seen = now = seen(imu, rests)
        if self._failed >= _FAILURES and self._any_attitude:
            return Advice("turn", f"Stop, for more attitudes do not help: {self._said}", held, up, now.had)
        if self._reached(now):
            asked = "it is as accurate as asked for" if self._targets else "these attitudes show every parameter"
            return Advice("done", f"Enough: {asked}.", held, up, now.had, known=self._known())
        note = _frozen(imu) or self._note(rests)
        if 0.5 < held < HOLD:
            # a standstill that has begun is among those found once it is long enough
            return Advice("hold", _hold(held), held, up, now.had, None, self._known(), note)
        wanted, text = self._next(now, up)
        again = len(now.had) > 1 and bool((angles(now.had[:-1], now.had[-1]) < SAME).any())
        if held >= HOLD and again and self._any_attitude:
            note = "This attitude is one that you have had."
        elif held >= HOLD and self._plan.method in ("six-position", "ferraris"):
            note = _askew(up) or note
        elif held <= 0.5 and _restless(imu):
            note = "It moves too much for a standstill: lay it down, or lean it against something."
        return Advice("turn", text, held, up, now.had, wanted, self._known(), note)

    def estimate(self, recording: Recording, advice: Advice, progress: Progress | None = None) -> None:
        """Calibrate a recording of which there was this advice."""
        self._counted = count = len(advice.had)
        try:
            found = self._calibrate(recording, progress=progress)
        except KreiselError as error:
            self._said = error.message if isinstance(error, RecordingError) else str(error)
            self._failed += 1
            return
        self._failed = 0
        if count >= FIRST or self._plan.attitudes < FIRST:
            self.outcome = found

    def _reached(self, now: Seen) -> bool:
        if self.outcome is None or not self.outcome.calibration.accepted:
            return False
        if not self._targets:
            return self._plan.enough(now) and not self._unobservable()
        known = self._known()
        return all(known.get(group, np.inf) <= target for group, target in self._targets.items())

    def _unobservable(self) -> list[str]:
        if self.outcome is None:
            return []
        names = self.outcome.calibration.verdict.unobservable
        return [name for name in names if self._only is None or name.startswith(self._only)]

    def _known(self) -> dict[str, float]:
        """Return the largest deviation of each group that is asked for, or of the usual ones."""
        if self.outcome is None:
            return {}
        deviation = np.sqrt(np.diag(self.outcome.calibration.covariance))
        groups = self._targets or self._usual
        return {group: max((float(deviation[i]) for i in self._of(group)), default=np.inf) for group in groups}

    def _of(self, group: str) -> list[int]:
        names = () if self.outcome is None else self.outcome.calibration.names
        return [i for i, name in enumerate(names) if name.startswith(f"{group}[")]

    def _note(self, rests: Rests) -> str:
        """Return what is in the way of a result, the most important of it."""
        had = self._seen.had
        if self._any_attitude and len(had) >= FIRST and float(angles(had, _mean(had)).max()) < _NARROW:
            return (
                "All attitudes so far are nearly alike. Scale factors and offsets of the accelerometers stay unknown "
                "then, however long it takes: turn the device over."
            )
        if rests.clipped:
            return f"{CLIPPED.format(count=rests.clipped)}."
        sag = float(np.median(_turned_while_held(rests)[-_LAST:]))
        if rests.count >= _LAST and sag > _SAG:
            return f"The device turns by {1e3 * sag:.0f} mrad while it is held still: lay it down, or support the hand."
        if self.outcome is None:
            return self._said if self._failed else ""
        for warning in self.outcome.warnings:
            if warning.subject == "turns":
                return f"{warning.message}."
        calibration, hidden = self.outcome.calibration, self._unobservable()
        if hidden and (calibration.accepted or calibration.verdict.reasons[0].startswith("not observable")):
            return f"Not shown yet: {_in_words(hidden)}."
        if not calibration.accepted:
            return calibration.verdict.reasons[0]
        return self._forecast(self.outcome) if self._plan.enough(self._seen) else ""

    def _forecast(self, outcome: StaticOutcome) -> str:
        """Return what is missing to what is asked for, where that is much; variances of a fit fall with its rows."""
        whole = np.diag(outcome.calibration.covariance)
        fit = np.minimum(np.diag(outcome.found.covariance)[: whole.size], whole)
        for group, target in self._targets.items():
            own = self._of(group)
            left, now = whole[own] - fit[own], float(np.sqrt(whole[own].max()))
            if left.max() >= (_FAR * target) ** 2:
                return (
                    f"{group} is {now / target:.3g} times as uncertain as asked for, and further attitudes hardly "
                    f"lower {np.sqrt(left.max()) / target:.3g} times of it. Ctrl-C ends the recording, and calibrates."
                )
            if left.max() >= target**2:
                continue  # it falls, too, but nobody knows how
            more = float(np.max(fit[own] / (target**2 - left))) * self._counted - self._counted
            if more > _MANY and self._any_attitude:
                return f"{group} takes about {float(f'{more:.2g}'):.0f} attitudes more to be as accurate as asked for."
        return ""

    def _next(self, now: Seen, up: Array) -> tuple[Array | None, str]:
        """Return what is to follow: the same until the device has stood still again."""
        if self._asked is None or self._asked[0] != len(now.had):
            self._asked = len(now.had), self._plan.next(now, up, self._worth)
        return self._asked[1]

    def _worth(self, candidates: Array, up: Array) -> Array:
        """Return what each direction would say, (k,), in deviations of use; before the first estimate nothing."""
        if self.outcome is None:
            return np.zeros(len(candidates))
        outcome = self.outcome
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


def _first(held: float, up: Array) -> Advice:
    if held > 0.5:
        return Advice("hold", _hold(held), held, up, np.zeros((0, 3)))
    return Advice("turn", "Lay the device down.", held, up, np.zeros((0, 3)))


def _frozen(imu: ImuSamples) -> str:
    """Return what to say if the readings have been the same for long."""
    readings = np.hstack([imu.rates, imu.accelerations])
    other = np.flatnonzero((readings != readings[-1]).any(axis=1))
    since = float(imu.seconds[-1] - imu.seconds[other[-1]]) if other.size else float(imu.seconds[-1])
    return (
        f"All readings have been the same for {since:.0f} s: does the device still measure?" if since > _FROZEN else ""
    )


def _turned_while_held(rests: Rests) -> Array:
    """Return the angle by which the device turns within each standstill, if evenly, rad, (M,)."""
    return np.asarray(np.sqrt(12.0) * rests.creep / lengths(rests.forces))


def _hold(held: float) -> str:
    return f"Hold still: {held:.1f} s of {HOLD:.0f} s."


def _mean(values: Array) -> Array:
    """Return the mean direction of vectors (n, 3)."""
    return np.asarray(directions(values.mean(axis=0)[None])[0])


def _in_words(names: Sequence[str]) -> str:
    groups = dict.fromkeys(name.partition("[")[0] for name in names)
    return ", ".join(_WORDS.get(group, group) for group in groups)


def _askew(up: Array) -> str:
    """Return what to say of a device that lies on none of its faces, though nearly."""
    off = float(angles(CANDIDATES[:FACES], up).min())
    return f"It lies {np.degrees(off):.0f} deg askew: lay it flat on the face." if FLAT < off < _ASKEW else ""


def _restless(imu: ImuSamples) -> bool:
    """Return whether the device keeps its attitude, but does not stand still."""
    count = round(_HELD / imu.interval)
    if len(imu.stamps_ns) < count:
        return False
    parts = np.array_split(imu.accelerations[-count:], 5)
    up = directions(np.array([part.mean(axis=0) for part in parts]))
    rates = imu.rates[-count:]
    away = lengths(rates - np.median(rates, axis=0))
    return bool(angles(up, _mean(up)).max() < _SWAYS and np.percentile(away, 95.0) < _TURNS)

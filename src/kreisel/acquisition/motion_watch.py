"""Monitoring of arm and IMU during the motion: reasons to stop, and whether the arm stands still."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import takewhile
from typing import Literal

import numpy as np

from kreisel.acquisition.rotation_watch import RotationWatch
from kreisel.devices.events import Arrival, Event, Level
from kreisel.geometry.rotation import Array
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.robot.agreement import Agreement
from kreisel.robot.description import Arm

NEAR = 3e-3
"""rad; an arm that stands within this distance of its target has arrived."""

STILL = 2e-4
"""rad; an arm whose joints stay within this range for `SETTLED` s rests."""

DRIFT = 5e-5
"""rad; largest difference between the mean angles of both halves of a standstill; detects slow motion."""

SETTLED = 0.3
"""s; duration of a standstill at a target. Chosen: six poses of the slowest source, KUKAVARPROXY with 20 a second, and
less than the rests of programs."""

MARGIN = math.radians(1.0)
"""rad; an arm is stopped when a joint is within this distance of its limit."""

OVERDUE = 0.2
"""Seconds without joint angles, or without readings of the IMU, after which the arm is stopped, and four intervals of
the source at least. Chosen: an arm at 1 rad/s turns by 11 deg meanwhile."""

_INTERVALS = 4.0
"""Usual intervals of a source that are no silence."""

_STALL = 0.05
"""s between two looks of this program from which it was late itself: what arrived meanwhile is taken first."""

FASTER = 1.25
"""Factor on commanded speeds, and on the tool speed allowed, beyond which the arm is stopped."""

_SPEED_SLACK = 0.05
"""rad/s, and m/s, by which speeds may be higher besides: noise of encoders, over `_SPEED_TIME`."""

_SPEED_TIME = 0.06
"""s over which speeds are taken. Chosen: longer than the interval of the slowest source, 20 poses a second."""

_FAST_AGAIN = 3
"""Poses in a row that must be too fast: one angle that is wrong is none."""

_IMU_TIME = 0.1
"""s over which the IMU's rates are averaged before they are compared with the commanded motion."""

_IMU_SLACK = 0.3
"""rad/s by which the IMU may turn faster than all joints together."""

ENDED = 1.0
"""Seconds at standstill, with no program running on the controller, after which a move has ended off its target."""

_AFTERWARDS = 1.0
"""s after the arm has come to rest from which the IMU must not turn. Chosen: an arm that swings has ended by then."""

_KEPT_NS = 4_000_000_000
"""ns; poses that are older are dropped. Chosen: twice the longest standstill that is asked for,
`stopping.SETTLE_TIME_BEFORE_MOVES`."""

_FRESH_NS = 300_000_000
"""ns; joint angles that are older say nothing of the present. Chosen: six intervals of the slowest source, 20 poses a
second."""

_FEWEST = 5
"""Poses that show a standstill. Chosen: each half has a mean (`DRIFT`), so that there are two in a half at least; 20
poses a second give ten within `stopping.SETTLE_TIME`."""

_BUNCHED = 0.75
"""Share of a standstill that must lie between the arrivals of its first and last pose. Chosen: bursts of 0.12 s are as
many as fit into `SETTLED`, 0.24 s of 0.3 s; poses that were held up and arrive together do not reach it."""

_SATURATED = 20
"""Equal readings in a row of a channel, while three or more change, that are saturation; as in `validation.masking`.
Chosen: rounded readings repeat a few times; 20 readings at 400 Hz are 50 ms."""

Row = tuple[int, int, tuple[float, ...]]
"""Host's time and stamp in ns, joint angles in rad."""


class Watch:
    """The latest data of arm and IMU during the motion, and a reason to stop, if there is one.

    Parameters
    ----------
    clock
        The host's monotonic clock, ns, of the readings' times of arrival.
    overdue
        Seconds of silence after which the arm is stopped.
    tool_speed
        Fastest allowed speed of the reported tool, m/s.

    Attributes
    ----------
    alarm
        A reason to stop, or None.
    sample
        The robot's last sample with joint angles.
    holds
        Whether the controller's last report says that it runs a program or has paused one.
    paused
        Whether it has paused one.
    tells_programs
        Whether it reports that at all.
    motion
        What moved at the last look whether the arm stands; empty if nothing did, or if nothing is known.
    witness
        Whether the IMU did not turn either when the arm last stood; None if it does not tell.
    arm
        The model.
    agreement
        The comparison of the model with the reported poses.
    rotation
        The comparison of the IMU with the joints.
    """

    def __init__(
        self,
        arm: Arm,
        clock: Callable[[], int] = time.monotonic_ns,
        *,
        overdue: float = OVERDUE,
        tool_speed: float = math.inf,
    ) -> None:
        self.alarm: str | None = None
        self.sample: RobotSample | None = None
        self.holds = self.paused = self.tells_programs = False
        self.motion = ""
        self.witness: bool | None = None
        self.agreement = Agreement(arm)
        self.rotation = RotationWatch(arm)
        self.arm, self._clock = arm, clock
        self._overdue, self._tool_speed = overdue, tool_speed
        self._arrivals = {"joint angles": _Arrivals(), "readings of the IMU": _Arrivals()}
        self._looked_ns = self._trusted_ns = self._settled_ns = 0
        self._turned = False
        self._positions: deque[tuple[int, tuple[float, ...]]] = deque()
        self._fastest: Array | None = None
        self._turning = math.inf
        self._fast = 0
        self._recent: deque[Row] = deque()
        self._same = [0] * 6
        self._last: tuple[float, ...] | None = None
        self._played = self._rests = self._ran = False
        self._idle_ns: int | None = None

    def take(self, event: Event) -> None:
        """Take an event of a device."""
        self._note_life()
        if not isinstance(event, Arrival):
            if event.level is Level.LOST:
                self.alarm = self.alarm or event.text
        elif isinstance(event.sample, ImuSample):
            self._arrivals["readings of the IMU"].take(event.host_ns)
            self.rotation.reading(event.host_ns, event.sample.stamp_ns, event.sample.rate)
            self._imu(event.sample)
        else:
            self._robot(event.sample, event.host_ns)

    @property
    def reason(self) -> str | None:
        """The reason to stop now: the alarm, or a device that sends nothing; None if there is no reason."""
        now = self._note_life()
        if self.alarm is None and self.ready and now > self._trusted_ns:
            for what, arrivals in self._arrivals.items():
                silent = (now - arrivals.last_ns) * 1e-9
                if silent > max(self._overdue, _INTERVALS * arrivals.interval):
                    self.alarm = self.alarm or f"no {what} for {silent:.1f} s"
        if self.alarm is None and self.rotation.mean_speed(now, _IMU_TIME) > self._turning:
            self.alarm = f"the IMU turns faster than the commanded motion can turn it, {self._turning:.2f} rad/s"
        if self.alarm is None and self._rests and now > self._settled_ns and self._creeps(now):
            self.alarm = "the joints are reported to rest, but the IMU turns"
        return self.alarm

    @property
    def ready(self) -> bool:
        """Whether data of both devices have been received."""
        return self._last is not None and bool(self._recent)

    @property
    def joints(self) -> Array | None:
        """The latest joint angles."""
        return np.array(self._recent[-1][2]) if self._recent else None

    @property
    def now_ns(self) -> int:
        """The host's time."""
        return self._clock()

    def hears(self) -> bool:
        """Return whether joint angles are being received."""
        return bool(self._recent) and self._clock() - self._recent[-1][0] < _FRESH_NS

    def rests_at(self, target: Array) -> bool:
        """Return whether the arm rests at a target, by joints and IMU."""
        if not self._recent:
            return False
        last_ns = self._recent[-1][1]
        rows = list(takewhile(lambda row: row[1] >= last_ns - SETTLED * 1e9, reversed(self._recent)))
        if last_ns - rows[-1][1] < SETTLED * 0.9e9:
            return False
        angles = np.array([joints for _, _, joints in rows])
        arrived = bool(np.all(np.ptp(angles, axis=0) < STILL) and np.all(np.abs(angles[0] - target) < NEAR))
        return arrived and self.rotation.still(self._clock(), SETTLED) is not False

    def stands(self, since_ns: int, seconds: float) -> bool:
        """Return whether the joints have stood still for the last `seconds` seconds, by samples after `since_ns`.

        The duration must be reached on both clocks: delayed readings that arrive together are not sufficient.
        """
        self.motion = ""
        if not self.hears():
            return False
        begin = max(since_ns, self._recent[-1][0] - round(seconds * 1e9))
        rows = list(takewhile(lambda row: row[0] >= begin, reversed(self._recent)))
        if len(rows) < _FEWEST or _span(rows, 1) < 0.9e9 * seconds or _span(rows, 0) < _BUNCHED * 1e9 * seconds:
            return False
        angles, half = np.array([joints for _, _, joints in rows]), len(rows) // 2
        drift = np.abs(angles[:half].mean(axis=0) - angles[half:].mean(axis=0))
        if not (np.all(np.ptp(angles, axis=0) < STILL) and np.all(drift < DRIFT)):
            self.motion = "the joints still move"
            return False
        witness = self.rotation.still(self._clock(), seconds)
        self.motion = "the joints are reported to stand, but the IMU turns" if witness is False else ""
        self.witness = witness
        return witness is not False

    @property
    def speed(self) -> float:
        """The largest speed of a joint just now, rad/s; the IMU's, where it has contradicted the joints."""
        if self.rotation.complaint is not None:
            return self.rotation.mean_speed(self._clock(), _IMU_TIME)
        return float(np.max(np.abs(self._joint_velocity())))

    def _joint_velocity(self) -> Array:
        return _velocity((stamp, joints) for _, stamp, joints in reversed(self._recent))

    def begin_move(self, peaks: Array | None = None) -> None:
        """Note that a move is sent, with the joints' largest speeds, rad/s; see `ended`."""
        self._played, self._idle_ns, self._rests = False, None, False
        self._fastest = None if peaks is None else FASTER * np.abs(peaks) + _SPEED_SLACK
        self._turning = math.inf if peaks is None else FASTER * float(np.sum(np.abs(peaks))) + _IMU_SLACK

    def rest(self) -> None:
        """Note that the arm rests at its target: a program that begins after ours has ended is not ours."""
        self._fastest, self._rests, self._turned = None, True, False
        self._settled_ns = self._clock() + round(_AFTERWARDS * 1e9)

    def ended(self) -> bool:
        """Return whether the controller began the move, no longer runs a program, and the arm stands still."""
        if self._idle_ns is None or self._clock() - self._idle_ns < ENDED * 1e9:
            return False
        return self.stands(self._idle_ns, ENDED)

    def _creeps(self, now: int) -> bool:
        """Return whether the IMU has turned all the time since the last look but one, `SETTLED` before."""
        self._settled_ns = now + round(SETTLED * 1e9)
        turns = self.rotation.still(now, SETTLED) is False
        again, self._turned = turns and self._turned, turns
        return again

    def _note_life(self) -> int:
        """Return the time; after a stall of this program devices are not called silent at once."""
        now = self._clock()
        if self._looked_ns and now - self._looked_ns > _STALL * 1e9:
            self._trusted_ns = now + round(_STALL * 1e9)
        self._looked_ns = now
        return now

    def _robot(self, sample: RobotSample, host_ns: int) -> None:
        if sample.blocked:
            self.alarm = self.alarm or f"the controller reports: {sample.blocked}"
        if sample.running is not None:
            if self._rests and self._played and sample.running and not self._ran:
                self.alarm = self.alarm or "another program has been started on the controller"
            self._ran = sample.running
            self._played = self._played or sample.running
            ended = self._played and not sample.running
            self._idle_ns = (self._idle_ns or host_ns) if ended else None
        self.holds = bool(sample.holds)
        self.paused = self.holds and sample.running is False
        self.tells_programs = self.tells_programs or sample.running is not None
        if not sample.joints:
            return
        if self._recent and sample.stamp_ns <= self._recent[-1][1]:
            self.alarm = self.alarm or "the robot's clock leapt: was its controller restarted?"
            self._recent.clear()
        self.sample = sample
        self._arrivals["joint angles"].take(host_ns)
        self._recent.append((host_ns, sample.stamp_ns, sample.joints))
        while self._recent[0][0] < host_ns - _KEPT_NS:
            self._recent.popleft()
        if sample.position is not None:
            self._positions.append((sample.stamp_ns, sample.position))
            while self._positions[0][0] < sample.stamp_ns - _KEPT_NS:
                self._positions.popleft()
        if len(sample.joints) == len(self.arm.joints):
            self.rotation.pose(host_ns, sample.stamp_ns, sample.joints)
        self.alarm = self.alarm or next(self._complaints(sample), None) or self.rotation.complaint

    def _complaints(self, sample: RobotSample) -> Iterator[str]:
        """Yield the faults of a pose."""
        arm = self.arm
        if len(sample.joints) != len(arm.joints):
            yield f"the robot reports {len(sample.joints)} joint angles, and the model has {len(arm.joints)} joints"
            return
        for name, angle, low, high in zip(arm.joints, sample.joints, arm.lower, arm.upper, strict=True):
            if not low + MARGIN < angle < high - MARGIN:
                yield (
                    f"{name} is at {math.degrees(angle):.1f} deg, within a degree of its limits "
                    f"{math.degrees(low):.0f} to {math.degrees(high):.0f} deg"
                )
        yield from self._speeding()
        self.agreement.take(sample)
        if self.agreement.complaint is not None:
            yield self.agreement.complaint

    def _speeding(self) -> Iterator[str]:
        """Yield how the arm is faster than commanded, or its tool faster than allowed."""
        joints, tool = self._joint_velocity(), _velocity(reversed(self._positions))
        allowed, way = FASTER * self._tool_speed + _SPEED_SLACK, float(np.linalg.norm(tool))
        over = np.zeros(1) if self._fastest is None else np.abs(joints) / self._fastest
        k = int(np.argmax(over))
        self._fast = self._fast + 1 if over[k] > 1.0 or way > allowed else 0
        if self._fast < _FAST_AGAIN:
            return
        if self._fastest is not None and over[k] > 1.0:
            yield (
                f"{self.arm.joints[k]} turns at {abs(joints[k]):.2f} rad/s, more than the {self._fastest[k]:.2f} rad/s "
                "of the command"
            )
        else:
            yield f"the tool moves at {way:.2f} m/s, more than the {self._tool_speed:g} m/s that are allowed"

    def _imu(self, sample: ImuSample) -> None:
        """Detect a saturated channel: it stays constant while others change."""
        values = (*sample.rate, *sample.acceleration)
        if self._last is not None:
            moving = sum(a != b for a, b in zip(values, self._last, strict=True)) >= 3
            for k, (a, b) in enumerate(zip(values, self._last, strict=True)):
                self._same[k] = self._same[k] + 1 if moving and a == b and a != 0.0 else 0
                if self._same[k] >= _SATURATED:
                    name = ("w_x", "w_y", "w_z", "a_x", "a_y", "a_z")[k]
                    self.alarm = self.alarm or f"the IMU is saturated: {name} stays at {a:.6g} while the others change"
        self._last = values


class _Arrivals:
    """When a source was last heard, and its usual interval."""

    _WEIGHT = 0.02
    """Of the last interval in the mean."""

    def __init__(self) -> None:
        self.last_ns = 0
        self.interval = 0.0

    def take(self, host_ns: int) -> None:
        """Note an arrival."""
        if self.last_ns:
            self.interval += self._WEIGHT * ((host_ns - self.last_ns) * 1e-9 - self.interval)
        self.last_ns = host_ns


def _velocity(rows: Iterable[tuple[int, tuple[float, ...]]]) -> Array:
    """Return the mean velocity over `_SPEED_TIME`, of rows of stamps in ns and places, the newest first.

    It is zero, (1,), where they do not last so long.
    """
    newest: tuple[int, tuple[float, ...]] | None = None
    for stamp, place in rows:
        newest = newest or (stamp, place)
        seconds = (newest[0] - stamp) * 1e-9
        if seconds >= _SPEED_TIME:
            return np.subtract(newest[1], place) / seconds
    return np.zeros(1)


def _span(rows: list[Row], clock: Literal[0, 1]) -> int:
    """Return the ns between the first and the last row, newest first, on the host's clock (0) or the robot's (1)."""
    return rows[0][clock] - rows[-1][clock]

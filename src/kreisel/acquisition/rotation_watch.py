"""The IMU as a second witness of the motion: how it turns, against how the joints say that the arm turns.

Angles are compared, which do not depend on how the IMU is mounted: the path of the IMU's rotation, and that of the
tool's by the model at the reported joint angles.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import takewhile

import numpy as np

from kreisel.geometry.rotation import Array, lengths
from kreisel.robot.description import Arm
from kreisel.robot.kinematics import poses

QUIET = 0.02
"""rad/s beyond the offset at rest; a larger mean rate is a rotation. Chosen: offsets that change with attitude by
0.1 deg/s per g stay ten times below it."""

_WINDOW = 0.2
"""s over which paths are compared. Chosen: as long as a silence that stops the arm."""

_LATE = 0.05
"""s by which readings and poses may arrive at different times: the interval of the slowest source."""

_FASTER = 1.3
"""Factor on the path that the joints report up to which the IMU agrees. Chosen: far above scale errors and noise."""

_SLACK = 0.1
"""rad/s that the IMU may turn faster besides: vibration, and the noise in the length of its rates."""

_REPORTED = 0.3
"""rad that the joints must turn the tool within `_LONG` before an IMU that does not turn is called loose."""

_SHORT = 0.1
"""s over which rates are averaged when the IMU is asked whether it turns: a swing has no mean over its period."""

_LONG = 1.5
"""s over which an IMU that turns differs from one that does not. Chosen: in the slow first move `_REPORTED`."""

_CREEP = 0.03
"""rad/s that the mean rate of an IMU may differ over `_LONG`. Chosen: a sway of 1 mrad at 3 Hz stays below."""

_AGAIN = 3
"""Comparisons in a row that must disagree."""

_SAMPLING = 0.02
"""s between poses whose attitude is computed. Chosen: a pose of the slowest source, and little work for others."""

_KEPT = 2.0  # s of history: more than any window
_FRESH = 0.3  # s; readings that are older say nothing of the present
_LONGEST = 0.1  # s; a longer interval between readings is a gap, and its rotation is not known


_DRIFT = 1e-2
"""Largest relative difference of a device's clock from the host's. Chosen: twice that of cheap clocks."""

_LEAP = 1.0  # s; a stamp that is farther from where it is expected is on another clock


class _HostTime:
    """Times of a device's stamps on the host's clock, by the quickest arrivals: however late or bunched others are."""

    def __init__(self) -> None:
        self._least: float | None = None
        self._host_ns = 0

    def of(self, stamp_ns: int, host_ns: int) -> float:
        """Return the host's time of a stamp, s, that arrived at `host_ns`."""
        late = (host_ns - stamp_ns) * 1e-9
        if self._least is None or abs(late - self._least) > _LEAP:
            self._least = late
        else:
            self._least = min(late, self._least + _DRIFT * (host_ns - self._host_ns) * 1e-9)
        self._host_ns = host_ns
        return stamp_ns * 1e-9 + self._least


class RotationWatch:
    """Takes readings and joint angles as they come, with their host's times in ns.

    Attributes
    ----------
    complaint
        How the IMU contradicts the joints, or None.
    loose
        Whether the joints turned the tool and the IMU did not turn: it is not on the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self.complaint: str | None = None
        self.loose = False
        self._arm = arm
        self._offset: Array | None = None
        self._readings: deque[tuple[float, Array]] = deque()
        self._of_imu: deque[tuple[float, float]] = deque()
        self._of_joints: deque[tuple[float, float]] = deque()
        self._of_means: deque[tuple[float, float]] = deque()
        self._sum, self._summed, self._since = np.zeros(3), 0, -np.inf
        self._stamp: int | None = None
        self._attitude: Array | None = None
        self._disagreed = 0
        self._trusted = self._compared = 0.0
        self._agreed = False
        self._imu_time, self._joint_time = _HostTime(), _HostTime()

    def learn_offset(self, seconds: float) -> None:
        """Take the mean of the last seconds, in which the arm stood, as the gyros' offset: it drifts."""
        if not self._readings:
            return
        if self._offset is None:  # what was gathered contains it
            self._of_imu.clear()
            self._of_joints.clear()
            self._of_means.clear()
        self._offset = np.mean([rate for _, rate in self._last(seconds)], axis=0)

    def reading(self, host_ns: int, stamp_ns: int, rate: tuple[float, float, float]) -> None:
        """Take a reading of the gyros, rad/s."""
        at, own = host_ns * 1e-9, np.array(rate)
        taken = self._noted(self._imu_time.of(stamp_ns, host_ns), self._of_imu)
        seconds = 0.0 if self._stamp is None else (stamp_ns - self._stamp) * 1e-9
        self._stamp = stamp_ns
        self._readings.append((at, own))
        step = self.speed_of(own) * min(max(seconds, 0.0), _LONGEST)
        self._of_imu.append((taken, (self._of_imu[-1][1] if self._of_imu else 0.0) + step))
        self._add_to_mean(taken, own)
        while self._readings[0][0] < at - _KEPT:
            self._readings.popleft()
        while self._of_imu[0][0] < taken - _KEPT:
            self._of_imu.popleft()

    def _add_to_mean(self, at: float, rate: Array) -> None:
        """Sum rates, and note the path of their means over `_SHORT`: vibration has none."""
        if at - self._since >= _SHORT:
            if self._summed:
                step = self.speed_of(self._sum / self._summed) * min(at - self._since, 2.0 * _SHORT)
                self._of_means.append((at, (self._of_means[-1][1] if self._of_means else 0.0) + step))
                while self._of_means[0][0] < at - _KEPT:
                    self._of_means.popleft()
            self._sum, self._summed, self._since = np.zeros(3), 0, at
        self._sum, self._summed = self._sum + rate, self._summed + 1

    def pose(self, host_ns: int, stamp_ns: int, joints: tuple[float, ...]) -> None:
        """Take joint angles, and compare."""
        at = self._joint_time.of(stamp_ns, host_ns)
        if self._of_joints and at - self._of_joints[-1][0] < _SAMPLING:
            return
        at = self._noted(at, self._of_joints)
        attitude = poses(self._arm, np.array([joints]))[1][0]
        turned = 0.0 if self._attitude is None else 2.0 * float(np.arccos(min(1.0, abs(attitude @ self._attitude))))
        self._attitude = attitude
        self._of_joints.append((at, (self._of_joints[-1][1] if self._of_joints else 0.0) + turned))
        while self._of_joints[0][0] < at - _KEPT:
            self._of_joints.popleft()
        self._compare()

    def speed_of(self, rate: Array) -> float:
        """Return the length of a rate without the offset, rad/s."""
        return float(np.linalg.norm(rate if self._offset is None else rate - self._offset))

    def still(self, now_ns: int, seconds: float) -> bool | None:
        """Return whether the IMU has not turned for so long; None if it does not tell.

        Before its offset is known, a rate that does not change is taken for it.
        """
        now = now_ns * 1e-9
        if self.loose or not self._readings or now - self._readings[-1][0] > _FRESH:
            return None
        pieces: dict[int, list[Array]] = {}
        for at, rate in self._last(seconds):
            pieces.setdefault(int((now - at) / _SHORT), []).append(rate)
        means = np.array([np.mean(rates, axis=0) for rates in pieces.values() if len(rates) > 1]).reshape(-1, 3)
        offset = self._offset if self._offset is not None else means.mean(axis=0) if len(means) else np.zeros(3)
        return bool(np.all(lengths(means - offset) < QUIET))

    def mean_speed(self, now_ns: int, seconds: float) -> float:
        """Return the mean length of the rates of the last seconds, rad/s; 0 without fresh readings or an offset."""
        if self._offset is None or not self._readings or now_ns * 1e-9 - self._readings[-1][0] > _FRESH:
            return 0.0
        return float(np.mean([self.speed_of(rate) for _, rate in self._last(seconds)]))

    def _last(self, seconds: float) -> Iterator[tuple[float, Array]]:
        """Yield the readings of the last seconds, the newest first."""
        newest = self._readings[-1][0]
        return takewhile(lambda one: one[0] > newest - seconds, reversed(self._readings))

    def _compare(self) -> None:
        """Compare the paths of both up to the last moment of which both are known."""
        if self._offset is None or not self._of_imu:
            return
        end = min(self._of_imu[-1][0], self._of_joints[-1][0] - _LATE)
        if end < self._trusted or end <= self._compared or not self._covers(end - _WINDOW - _LATE):
            return
        self._compared = end
        turned = _path(self._of_imu, end - _WINDOW, end)
        reported = _path(self._of_joints, end - _WINDOW - _LATE, end + _LATE)
        too_far = turned > _FASTER * reported + _SLACK * _WINDOW
        self._disagreed = self._disagreed + 1 if too_far and not self.loose else 0
        if self._disagreed >= _AGAIN:
            self.complaint = _contradiction(turned, _WINDOW, reported)
        if not self._covers(end - _LONG):
            return
        if len(self._of_means) > 1 and self._of_means[0][0] <= end - _LONG and not self.loose:
            crept = _path(self._of_means, end - _LONG, end)
            reported = _path(self._of_joints, end - _LONG - _LATE, end + _LATE)
            if crept > _FASTER * reported + _CREEP * _LONG:
                self.complaint = _contradiction(crept, _LONG, reported)
        reported_long, turned_long = _path(self._of_joints, end - _LONG, end), _path(self._of_imu, end - _LONG, end)
        if reported_long < _REPORTED:
            return
        if turned_long > 0.7 * reported_long:
            self._agreed = True
        elif turned_long < 0.3 * reported_long and self._agreed:
            self.complaint = (
                f"the IMU turned by {np.degrees(turned_long):.1f} deg in {_LONG:g} s, and the joints by "
                f"{np.degrees(reported_long):.1f} deg, though it turned with them before: has it come off, or are its "
                "readings frozen?"
            )
        elif turned_long < 0.3 * reported_long:
            self.loose = True

    def _noted(self, at: float, of: deque[tuple[float, float]]) -> float:
        """Return a time that is not before the last; after missing data, nothing is compared until they are past."""
        if not of:
            return at
        if at - of[-1][0] > 2.0 * _LATE:
            self._trusted = at + _WINDOW + 2.0 * _LATE
        return max(at, of[-1][0])

    def _covers(self, begin: float) -> bool:
        return all(len(of) > 1 and of[0][0] <= begin for of in (self._of_imu, self._of_joints))


def _contradiction(turned: float, seconds: float, reported: float) -> str:
    return (
        f"the IMU turned by {np.degrees(turned):.1f} deg in {seconds:g} s, and the joints are reported to turn it by "
        f"{np.degrees(reported):.1f} deg: are the reported angles frozen, or is the IMU loose?"
    )


def _path(of: deque[tuple[float, float]], begin: float, end: float) -> float:
    """Return the path between two moments, s."""
    times, angles = np.array(of).T
    return float(np.diff(np.interp([begin, end], times, angles))[0])

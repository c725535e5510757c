"""A simulated arm that takes moves: a recording in which each standstill lasts until the next move is commanded.

While the arm waits, a part of the standstill is played repeatedly; stamps continue to increase.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from kreisel.devices.simulators import imu_samples, robot_samples
from kreisel.errors import SettingsError
from kreisel.geometry.rotation import Array
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.recording.recording import Recording

Sample = TypeVar("Sample", ImuSample, RobotSample)

NEAR = 1e-2
"""rad; targets that differ by less are considered equal."""

_MIN_STANDSTILL = 0.7
"""s; shorter standstills are no rests of the program. Chosen: without both `_EDGE`s 0.4 s are left to repeat; rests of
programs are longer, and an arm that reverses stands still for some samples."""

_EDGE = 0.15  # s at both ends of a standstill that are not repeated: the clocks differ by less


@dataclass(frozen=True)
class _Standstill:
    """An interval without motion: its first and last time, s of the robot's clock, and the joint angles."""

    begin: float
    end: float
    joints: Array


class CommandedArm:
    """The state of such an arm, and the samples of its devices.

    Parameters
    ----------
    recording
        With joint angles, and with standstills at the beginning and between moves.

    Raises
    ------
    SettingsError
        If it has no joint angles, or no standstills.
    """

    def __init__(self, recording: Recording) -> None:
        if recording.joints is None or recording.reference is None:
            raise SettingsError("an arm that takes moves needs joint angles; leave reference.joints at its default")
        self._samples: tuple[list[ImuSample], list[RobotSample]] = (
            list(imu_samples(recording.imu)), list(robot_samples(recording)),
        )  # fmt: skip
        stamps = recording.imu.stamps_ns, recording.reference.stamps_ns
        self._times_ns = tuple(of - of[0] for of in stamps)
        self._standstills = _standstills(recording)
        self._intervals_ns = [round(float(np.median(np.diff(of)))) for of in stamps]
        self._grain_ns = math.lcm(*self._intervals_ns)
        self._content_ns = 0
        self._shift_ns = 0
        self._at = 0
        self._moving = False
        self._frozen = False
        self._next = [0, 0]
        self._stopped: tuple[int, ImuSample, RobotSample] | None = None

    def move(self, target: Sequence[float]) -> str | None:
        """Move to the recording's next target, rad; return why it is refused if `target` is another one."""
        here = self._standstills[self._at].joints
        if self._moving or self._frozen:
            return "a move while another is under way"
        if np.max(np.abs(np.array(target) - here)) < NEAR:
            return None
        if self._at + 1 >= len(self._standstills):
            return "a move after the last"
        if np.max(np.abs(np.array(target) - self._standstills[self._at + 1].joints)) > NEAR:
            return f"a move to another target than the program's {self._at + 1}"
        self._skip_to(self._standstills[self._at].end - _EDGE)
        self._moving = True
        return None

    def stop(self) -> None:
        """Stop the arm where it is; it takes no more moves.

        Joints and pose stay constant from then on. The IMU repeats a rate of the standstill before, with the
        acceleration at the time of the stop: braking is not simulated.
        """
        if self._moving and not self._frozen:
            self._frozen = True
            self._stopped = (self._content_ns, *self._standing())

    @property
    def moving(self) -> bool:
        """Whether a move is under way."""
        return self._moving and not self._frozen

    def advance(self, seconds: float) -> tuple[list[ImuSample], list[RobotSample]]:
        """Return the samples of the next `seconds` seconds."""
        if self._frozen:
            return self._stand(round(seconds * 1e9))
        self._content_ns += round(seconds * 1e9)
        if self._moving and self._content_ns * 1e-9 > self._standstills[self._at + 1].begin + _EDGE:
            self._at += 1
            self._moving = False
        readings, poses = self._samples
        found = (
            [_later(sample, self._shift_ns) for sample in readings[self._due(0)]],
            [_later(sample, self._shift_ns) for sample in poses[self._due(1)]],
        )
        if (
            not self._moving
            and self._content_ns * 1e-9 > self._standstills[self._at].end - _EDGE - 1e-9 * self._grain_ns
        ):
            self._skip_to(self._standstills[self._at].begin + _EDGE)
        return found

    def _standing(self) -> tuple[ImuSample, RobotSample]:
        """Return the samples that the stopped arm repeats from now on."""
        readings, poses = self._samples
        last, pose = readings[max(0, self._next[0] - 1)], poses[max(0, self._next[1] - 1)]
        standing = round((self._standstills[self._at].begin + _EDGE) * 1e9)
        still = readings[int(np.searchsorted(self._times_ns[0], standing))]
        return replace(last, rate=still.rate), pose

    def _stand(self, passed_ns: int) -> tuple[list[ImuSample], list[RobotSample]]:
        """Return the samples of the next `passed_ns` ns, with stamps of regular sampling."""
        assert self._stopped is not None  # noqa: S101 - for the type checker; it is frozen
        now_ns, reading, pose = self._stopped
        self._stopped = (now_ns + passed_ns, reading, pose)

        def stamps(which: int) -> range:
            interval, first = self._intervals_ns[which], int(self._times_ns[which][max(0, self._next[which] - 1)])
            begin = first + ((now_ns - first) // interval + 1) * interval
            return range(begin, now_ns + passed_ns + 1, interval)

        shifts = [of[0].stamp_ns + self._shift_ns for of in self._samples]
        return (
            [replace(reading, stamp_ns=shifts[0] + at) for at in stamps(0)],
            [replace(pose, stamp_ns=shifts[1] + at) for at in stamps(1)],
        )

    def _skip_to(self, seconds: float) -> None:
        """Continue at another time of the same standstill, shifted by whole samples of both devices."""
        grains = int((seconds * 1e9 - self._content_ns) / self._grain_ns)
        self._content_ns += grains * self._grain_ns
        self._shift_ns -= grains * self._grain_ns
        self._next = [int(np.searchsorted(times, self._content_ns, "right")) for times in self._times_ns]

    def _due(self, which: int) -> slice:
        """Return the samples of a device that are due, as a slice."""
        begin = self._next[which]
        self._next[which] = max(begin, int(np.searchsorted(self._times_ns[which], self._content_ns, "right")))
        return slice(begin, self._next[which])


def _later(sample: Sample, shift_ns: int) -> Sample:
    return replace(sample, stamp_ns=sample.stamp_ns + shift_ns)


def _standstills(recording: Recording) -> list[_Standstill]:
    """Return the standstills, found from the joint angles."""
    joints = recording.joints
    assert joints is not None  # noqa: S101 - for the type checker; the caller checks
    t = (joints.stamps_ns - joints.stamps_ns[0]) * 1e-9
    edges = np.diff(np.concatenate([[0], _still(joints.angles).astype(np.int8), [0]]))
    pairs: Iterator[tuple[int, int]] = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    found = [
        _Standstill(float(t[a]), float(t[b]), joints.angles[b]) for a, b in pairs if t[b] - t[a] >= _MIN_STANDSTILL
    ]
    if len(found) < 2:
        raise SettingsError(
            f"the program has {len(found)} rests of {_MIN_STANDSTILL} s and more, expected two at least"
        )
    return found


def _still(angles: Array) -> Array:
    return np.asarray(np.max(np.abs(np.diff(angles, axis=0)), axis=1) < 1e-7)

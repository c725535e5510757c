"""What the page is told: messages made of what a recording has by now. No network here."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from kreisel.acquisition.record import Excitation
from kreisel.acquisition.tail import Tail
from kreisel.dashboard.online import Estimate
from kreisel.errors import RobotError
from kreisel.protocols import ImuSample
from kreisel.recording.mcap import IMU_TOPIC, JOINT_TOPIC, POSE_TOPIC, POSITION_TOPIC, WARN
from kreisel.robot.kinematics import Arm, parse_arm, skeleton

WINDOW = 10.0
"""Seconds of readings a browser that comes late is shown."""

Message = dict[str, Any]


class Feed:
    """Messages about a recording, new ones and those that bring a newcomer up to date."""

    def __init__(self, tail: Tail) -> None:
        self._tail = tail
        self._sent = 0
        self._excitation = Excitation()
        self._recent: deque[list[float]] = deque(maxlen=5000)
        self._estimates: list[Message] = []
        self._status: Message = {"kind": "status"}
        self._pose: Message | None = None
        self._arm: Arm | None = None
        self._no_arm = False

    def news(self) -> list[Message]:
        """Return what has come since the last call."""
        self._tail.read()
        topics = self._tail.topics()
        messages: list[Message] = []
        stamps, _, rows = topics.get(IMU_TOPIC, (np.zeros(0, dtype=np.int64), [], []))
        if len(rows) > self._sent:
            messages.append(self._readings(stamps, rows))
        robot = topics.get(POSE_TOPIC) or topics.get(POSITION_TOPIC)
        joints = topics.get(JOINT_TOPIC)
        if robot is not None and len(robot[2]):
            self._pose = {
                "kind": "pose",
                "t": robot[0][-1] * 1e-9,
                "pose": list(robot[2][-1]),
                "arm": self._skeleton(joints[2][-1]) if joints is not None and joints[2] else None,
            }
            messages.append(self._pose)
        self._status = {
            "kind": "status",
            "file": str(self._tail.file),
            "ended": self._tail.ended,
            "imu": _facts(stamps),
            "robot": _facts(robot[0]) if robot is not None else _facts(np.zeros(0, dtype=np.int64)),
            "lacks": self._excitation.missing(),
            "turned_deg": [round(float(np.degrees(angle)), 1) for angle in self._excitation.turned],
            "notes": [{"warning": level >= WARN, "text": text} for level, text in self._tail.notes()[-50:]],
        }
        return [*messages, self._status]

    def estimate(self, found: Estimate) -> Message:
        """Return the message of an estimate, and keep it."""
        message = {
            "kind": "estimate",
            "seconds": found.seconds,
            "names": list(found.names),
            "values": found.values.tolist(),
            "deviations": found.deviations.tolist(),
            "accepted": found.accepted,
            "said": found.said,
        }
        self._estimates.append(message)
        return message

    def so_far(self) -> list[Message]:
        """Return what a browser needs that has just come."""
        readings: list[Message] = [{"kind": "imu", "rows": list(self._recent)}] if self._recent else []
        pose = [] if self._pose is None else [self._pose]
        return [*readings, *pose, *self._estimates, self._status]

    def _readings(self, stamps: Any, rows: list[tuple[float, ...]]) -> Message:
        new = []
        for k in range(self._sent, len(rows)):
            t, row = int(stamps[k]), rows[k]
            step = 0.0 if k == 0 else min(0.1, (t - int(stamps[k - 1])) * 1e-9)
            self._excitation.take(ImuSample(t, (row[0], row[1], row[2]), (row[3], row[4], row[5])), step)
            new.append([t * 1e-9, *row[:6]])
        self._sent = len(rows)
        self._recent.extend(new)
        while self._recent and self._recent[0][0] < new[-1][0] - WINDOW:
            self._recent.popleft()
        return {"kind": "imu", "rows": new}

    def _skeleton(self, angles: tuple[float, ...]) -> list[list[float]] | None:
        """Return where the arm's joints are, if its description is known and fits."""
        if self._arm is None and self._tail.urdf is not None and not self._no_arm:
            try:
                self._arm = parse_arm(self._tail.urdf)
            except RobotError:
                self._no_arm = True
        if self._arm is None or len(angles) != len(self._arm.joints):
            return None
        return [[float(x) for x in point] for point in skeleton(self._arm, np.array(angles))]


def _facts(stamps: Any) -> Message:
    recent = stamps[-400:]
    seconds = float(recent[-1] - recent[0]) * 1e-9 if recent.size > 1 else 0.0
    return {
        "count": int(stamps.size),
        "rate": round((recent.size - 1) / seconds, 2) if seconds > 0.0 else 0.0,
        "last": float(stamps[-1] * 1e-9) if stamps.size else None,
    }

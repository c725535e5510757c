"""Messages to the page about the data recorded so far. No network here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from kreisel.acquisition.recorder import Excitation
from kreisel.acquisition.tail import Rows, Tail
from kreisel.dashboard.live_estimate import LiveEstimate
from kreisel.dashboard.live_goals import goals_of
from kreisel.dashboard.live_quantities import quantities_of
from kreisel.dashboard.message import Message
from kreisel.errors import RobotError
from kreisel.formats.mcap import WARN
from kreisel.formats.topic_names import IMU_TOPIC, JOINT_TOPIC, POSE_TOPIC, POSITION_TOPIC
from kreisel.protocols.samples import ImuSample
from kreisel.robot.description import Arm, parse_arm
from kreisel.robot.kinematics import skeleton

WINDOW = 10.0
"""Seconds of readings sent to a newly connected browser."""

MAX_ESTIMATES = 2000
"""Estimates sent to a newly connected browser; of more, the last and evenly spaced earlier ones are sent."""

Look = Callable[[], LiveEstimate | None]


class Feed:
    """Messages about a recording: new ones, and those for a newly connected browser.

    look: returns a new estimate of the recording if one is due; see `dashboard.online`.
    """

    def __init__(self, path: Path, look: Look = lambda: None) -> None:
        self._look, self._path = look, path
        self._tail = Tail(path, keep=False)
        self._excitation = Excitation()
        self._streams = {name: _StreamState() for name in ("imu", "robot")}
        self._recent: deque[list[float]] = deque()
        self._estimates: list[Message] = []
        self._status: Message = {"kind": "status"}
        self._pose: Message | None = None
        self._arm: Arm | None = None
        self._no_arm = False

    def news(self) -> list[Message]:
        """Return the messages about data written since the last call."""
        new = self._tail.read()
        messages: list[Message] = []
        if IMU_TOPIC in new:
            messages.append(self._readings(new[IMU_TOPIC]))
        robot, joints = new.get(POSE_TOPIC) or new.get(POSITION_TOPIC), new.get(JOINT_TOPIC)
        if robot is not None:
            self._streams["robot"].take(robot.stamps_ns)
            self._pose = {
                "kind": "pose",
                "t": robot.stamps_ns[-1] * 1e-9,
                "pose": robot.row(-1),
                "arm": None if joints is None else self._skeleton(joints.row(-1)),
            }
            messages.append(self._pose)
        self._status = {
            "kind": "status",
            "file": str(self._tail.file),
            "ended": self._tail.ended,
            **{name: stream.message() for name, stream in self._streams.items()},
            "lacks": self._excitation.missing(),
            "turned_deg": [round(float(np.degrees(angle)), 1) for angle in self._excitation.turned],
            "goals": goals_of(self._path),
            "notes": [{"warning": level >= WARN, "text": text} for level, text in self._tail.notes[-50:]],
        }
        return [*messages, self._status]

    def look(self) -> Message | None:
        """Return the message about a new estimate if one is due."""
        found = self._look()
        return None if found is None else self.estimate(found)

    def estimate(self, found: LiveEstimate) -> Message:
        """Return the message about an estimate, and keep it."""
        message = {
            "kind": "estimate",
            "seconds": found.seconds,
            "names": list(found.names),
            "values": found.values.tolist(),
            "deviations": found.deviations.tolist(),
            "quantities": quantities_of(found.calibration),
            "accepted": found.accepted,
            "summary": found.summary,
        }
        self._estimates.append(message)
        return message

    def so_far(self) -> list[Message]:
        """Return the messages for a newly connected browser."""
        readings: list[Message] = [{"kind": "imu", "rows": list(self._recent)}] if self._recent else []
        pose = [] if self._pose is None else [self._pose]
        return [*readings, *pose, *self._history(), self._status]

    def _history(self) -> list[Message]:
        """Return all estimates as one message; after hours there are too many for single messages."""
        every = -(-len(self._estimates) // MAX_ESTIMATES)
        return [{"kind": "estimates", "every": every, "estimates": self._estimates[::-every][::-1]}] if every else []

    def _readings(self, imu: Rows) -> Message:
        new, stream = [], self._streams["imu"]
        before = stream.last_ns
        for k, t in enumerate(imu.stamps_ns):
            row = imu.row(k)
            step = 0.0 if before is None else min(0.1, (t - before) * 1e-9)
            self._excitation.take(ImuSample(t, (row[0], row[1], row[2]), (row[3], row[4], row[5])), step)
            new.append([t * 1e-9, *row[:6]])
            before = t
        stream.take(imu.stamps_ns)
        self._recent.extend(new)
        while self._recent[0][0] < new[-1][0] - WINDOW:
            self._recent.popleft()
        return {"kind": "imu", "rows": [row for row in new if row[0] >= self._recent[0][0]]}

    def _skeleton(self, angles: Sequence[float]) -> list[list[float]] | None:
        """Return the positions of the arm's joints, if its description is known and fits."""
        if self._arm is None and self._tail.urdf is not None and not self._no_arm:
            try:
                self._arm = parse_arm(self._tail.urdf)
            except RobotError:
                self._no_arm = True
        if self._arm is None or len(angles) != len(self._arm.joints):
            return None
        return [[float(x) for x in point] for point in skeleton(self._arm, np.array(angles))]


class _StreamState:
    """Number and rate of a stream's messages."""

    def __init__(self) -> None:
        self._count = 0
        self._recent: deque[int] = deque(maxlen=400)

    @property
    def last_ns(self) -> int | None:
        return self._recent[-1] if self._recent else None

    def take(self, stamps_ns: Iterable[int]) -> None:
        stamps = list(stamps_ns)
        self._count += len(stamps)
        self._recent.extend(stamps)

    def message(self) -> Message:
        recent = self._recent
        seconds = (recent[-1] - recent[0]) * 1e-9 if recent else 0.0
        rate = round((len(recent) - 1) / seconds, 2) if seconds > 0.0 else 0.0
        return {"count": self._count, "rate": rate, "last": recent[-1] * 1e-9 if recent else None}

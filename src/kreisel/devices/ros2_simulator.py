"""A simulated ROS 2 system: it publishes the readings of an IMU, or the joint angles and frames of an arm."""

from __future__ import annotations

import asyncio
import random
import socket
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from kreisel.devices.address import IMUS, parse_address
from kreisel.devices.ros2_network import participant_at
from kreisel.devices.simulators import Pace, play
from kreisel.protocols import ros2
from kreisel.protocols.samples import ImuSample, RobotSample

TOPICS = {"imu": {"/imu/data_raw": ros2.IMU}, "robot": {"/joint_states": ros2.JOINTS, "/tf": ros2.FRAMES}}
"""Topics that are published, and the types of their messages, by the device."""

BASE, TOOL = "base_link", "tool0"

FRAMES_AND_JOINTS = f"pose=/tf&joints=/joint_states&base={BASE}&tool={TOOL}"
"""Options with which all of it is read."""

DOMAINS = range(1, 100)
"""Domains whose ports lie below those that Linux gives to clients (docs.ros.org, "The ROS_DOMAIN_ID")."""

_LOOK = 0.02  # s between two looks for a client
_PORTS = (7400, 250, 10)
"""First port of the first domain, distance to the next one's, and offset of a first participant (RTPS 2.2, 9.6)."""


def free_domain(host: str) -> int:
    """Return the number of a domain that nobody on this machine uses."""
    for number in random.sample(DOMAINS, len(DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((host, _PORTS[0] + _PORTS[1] * number + _PORTS[2]))
            except OSError:
                continue
            return number
    return DOMAINS[0]


class Ros2Simulator:
    """Publishers of one device; they are used as the simulators of devices that clients connect to: see `TcpSimulator`.

    Parameters
    ----------
    device
        `imu` or `robot`.
    on_client
        Called when the first client reads.
    """

    def __init__(self, device: str, on_client: Callable[[], None] = lambda: None) -> None:
        self._topics, self._on_client = TOPICS[device], on_client
        self._writers: dict[str, tuple[Any, Any]] = {}
        self._participant: Any = None
        self._waiting: asyncio.Task[None] | None = None

    async def serve(self, host: str, domain: int) -> int:
        """Join a domain, and return its number."""
        self._participant = participant_at(parse_address(f"ros2://{host}?domain={domain}", IMUS))
        for topic, kind in self._topics.items():
            self._writers[topic] = _writer(self._participant, topic, kind)
        self._waiting = asyncio.ensure_future(self._wait())
        return domain

    async def play(self, samples: Iterator[ImuSample] | Iterator[RobotSample], pace: Pace) -> None:
        """Publish samples at their times, then close."""
        await play(self, samples, pace)

    def send(self, samples: Iterable[ImuSample | RobotSample]) -> None:
        """Publish samples."""
        for sample in samples:
            if isinstance(sample, ImuSample):
                self.publish("/imu/data_raw", ros2.encode_imu(sample))
                continue
            if sample.joints:
                self.publish("/joint_states", ros2.encode_joints(ros2.as_published(sample.stamp_ns, sample.joints)))
            if sample.position is not None and sample.quaternion is not None:
                frame = ros2.Transform(sample.stamp_ns, BASE, TOOL, sample.position, sample.quaternion)
                self.publish("/tf", ros2.encode_frames([frame]))

    def publish(self, topic: str, content: bytes) -> None:
        """Publish a message."""
        from kreisel.devices.ros2_types import with_content

        writer, kind = self._writers[topic]
        writer.write(with_content(kind, content))

    def close(self) -> None:
        """Leave the domain."""
        if self._waiting is not None:
            self._waiting.cancel()
        self._writers.clear()
        self._participant = None

    async def _wait(self) -> None:
        while not any(writer.get_matched_subscriptions() for writer, _ in self._writers.values()):
            await asyncio.sleep(_LOOK)
        self._on_client()


def _writer(participant: Any, topic: str, kind: str) -> tuple[Any, Any]:
    """Return a publisher of a topic, with the settings of sensors, and the type of its messages."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    from kreisel.devices.ros2_types import TYPES

    qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(100))
    return DataWriter(participant, Topic(participant, f"rt{topic}", TYPES[kind]), qos=qos), TYPES[kind]

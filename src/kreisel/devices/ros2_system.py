"""A ROS 2 system as a device, without ROS on this machine: readings of an IMU, or joint angles and poses of a robot."""

from __future__ import annotations

import asyncio
import queue
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Protocol

from kreisel.devices.address import Address
from kreisel.devices.datagrams import Clock
from kreisel.devices.dialogue import Found, Remark
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.devices.faults import SILENCE, Faults, Silence
from kreisel.devices.ros2_network import MESSAGES, Network, network_of
from kreisel.errors import ProtocolError, SettingsError
from kreisel.protocols import ros2
from kreisel.protocols.samples import RobotSample

KINDS_OF_POSES = (ros2.POSE, ros2.TRANSFORM, ros2.FRAMES)
"""Types of messages with poses."""

_STATIC = "/tf_static"
_HELD = 64
"""Messages with joint angles that wait for the pose of the same time. Chosen: a tenth of a second at 500 Hz, and a
publisher of frames answers each message with joint angles at once."""


_WAITING = 8
"""Poses that wait for the angles of their time. Chosen: two messages of one publisher arrive less far apart."""


class Listener(Protocol):
    """What becomes of the messages of some topics."""

    topics: tuple[str, ...]
    kinds: frozenset[str]

    def take(self, topic: str, kind: str, content: bytes) -> list[Found]:
        """Return what a message of a topic, of a type, contains."""


class ImuListener:
    """Readings of the topic of an IMU; `?topic=/imu/data_raw`."""

    kinds = frozenset({ros2.IMU})

    def __init__(self, address: Address) -> None:
        self.topics: tuple[str, ...] = (_topic(address, "topic", "/imu/data_raw"),)

    def take(self, topic: str, kind: str, content: bytes) -> list[Found]:
        """Return the reading of a message."""
        if kind != ros2.IMU:
            raise ProtocolError("ROS 2", f"{topic} has messages of type {kind}, expected {ros2.IMU}")
        return [ros2.decode_imu(content)]


class RobotListener:
    """Joint angles, or poses, or both, of a robot.

    `?joints=/joint_states` names the topic with angles, and `&names=` the joints from the base on where their names do
    not show it. `?pose=` names a topic with poses; with frames, `&base=` and `&tool=` name two of them. If both are
    named, angles and pose of the same time become one sample.
    """

    kinds = frozenset({ros2.JOINTS, *KINDS_OF_POSES})

    def __init__(self, address: Address) -> None:
        options = address.options
        pose = options.get("pose")
        joints = options.get("joints", None if pose else "/joint_states")
        self._pose = None if pose is None else _topic(address, "pose", pose)
        self._joints = None if joints is None else _topic(address, "joints", joints)
        self._names = tuple(name for name in options.get("names", "").split(",") if name)
        if ("base" in options) != ("tool" in options):
            raise SettingsError(f"{address}: frames are named by base and tool together, as ?base=base_link&tool=tool0")
        self._chain = ros2.Chain(options["base"], options["tool"]) if "base" in options else None
        self._said = False
        self._held: dict[int, tuple[float, ...]] = {}
        self._poses: deque[RobotSample] = deque()
        self.topics = tuple(t for t in (self._joints, self._pose, _STATIC if self._chain else None) if t is not None)

    def take(self, topic: str, kind: str, content: bytes) -> list[Found]:
        """Return the angles or the pose of a message."""
        if topic == self._joints and kind == ros2.JOINTS:
            return self._angles(ros2.decode_joints(content))
        if topic == _STATIC and self._chain is not None:
            self._chain.take(ros2.decode_frames(content), static=True)
            return []
        if topic != self._pose or kind not in KINDS_OF_POSES:
            wanted = ros2.JOINTS if topic == self._joints else ", ".join(KINDS_OF_POSES)
            raise ProtocolError("ROS 2", f"{topic} has messages of type {kind}, expected {wanted}")
        sample = self._posed(kind, content)
        if sample is not None:
            self._poses.append(sample)
        return self._paired()

    def _posed(self, kind: str, content: bytes) -> RobotSample | None:
        if kind == ros2.POSE:
            return ros2.decode_pose(content)
        if kind == ros2.TRANSFORM:
            one = ros2.decode_transform(content)
            return RobotSample(one.stamp_ns, one.position, one.quaternion)
        if self._chain is None:
            frames = ", ".join(sorted({one.child for one in ros2.decode_frames(content)}))
            raise ProtocolError("ROS 2", f"name two frames, as ?base=base_link&tool=tool0; these come: {frames}")
        return self._chain.take(ros2.decode_frames(content))

    def _angles(self, joints: ros2.Joints) -> list[Found]:
        found: list[Found] = []
        if not self._names:
            self._names = ros2.from_base(joints.names) or ()
            if not self._names:
                raise ProtocolError(
                    "ROS 2",
                    "the names of the joints do not show their order; state it from the base on, as ?names="
                    + ",".join(joints.names),
                )
        if not self._said:
            self._said = True
            found.append(Remark(f"joints from the base on: {', '.join(self._names)}"))
        by_name = dict(zip(joints.names, joints.angles, strict=True))
        missing = [name for name in self._names if name not in by_name]
        if missing:  # others publish their own joints on the same topic, for example a gripper
            if not by_name.keys() & set(self._names):
                return found
            raise ProtocolError("ROS 2", f"no angle of {', '.join(missing)} among {', '.join(joints.names)}")
        angles = tuple(by_name[name] for name in self._names)
        if self._pose is None:
            return [*found, RobotSample(joints.stamp_ns, None, None, angles)]
        self._held[joints.stamp_ns] = angles
        while len(self._held) > _HELD:
            del self._held[next(iter(self._held))]
        return [*found, *self._paired()]

    def _paired(self) -> list[Found]:
        """Return the poses whose angles have come, and those whose angles will not come any more.

        The two topics arrive in any order.
        """
        out: list[Found] = []
        newest = max(self._held, default=0)
        while self._poses:
            stamp_ns = self._poses[0].stamp_ns
            waits = self._joints is not None and newest < stamp_ns and len(self._poses) <= _WAITING
            if waits and stamp_ns not in self._held:
                break
            out.append(replace(self._poses.popleft(), joints=self._held.pop(stamp_ns, ())))
        return out


def _topic(address: Address, option: str, default: str) -> str:
    name = address.options.get(option, default)
    if not name.startswith("/") or len(name) < 2:
        raise SettingsError(f"{address}: {option} is '{name}', expected the name of a topic, as {default}")
    return name


def listener_at(address: Address) -> Listener:
    """Return what becomes of the messages for an address, as an IMU's or a robot's.

    Raises
    ------
    SettingsError
        If an option is invalid.
    """
    network_of(address)
    return ImuListener(address) if address.device == "imu" else RobotListener(address)


async def ros2_events(address: Address, clock: Clock = time.monotonic_ns) -> AsyncIterator[Event]:
    """Yield the events of a device in a ROS 2 system.

    Raises
    ------
    SettingsError, DeviceError
        If the network cannot be joined.
    """
    listener, loop = listener_at(address), asyncio.get_running_loop()
    waiting: queue.Queue[tuple[str, str, bytes, int]] = queue.Queue(4 * MESSAGES)
    arrived, dropped = asyncio.Event(), [0]

    def take(topic: str, kind: str, content: bytes) -> None:
        try:
            waiting.put_nowait((topic, kind, content, clock()))
        except queue.Full:
            dropped[0] += 1
        loop.call_soon_threadsafe(arrived.set)

    network = Network(address, listener.topics, take)
    faults, silence, lost, shared = Faults(), Silence(address, clock()), 0, 0
    try:
        while True:
            try:
                async with asyncio.timeout(SILENCE):
                    await arrived.wait()
            except TimeoutError:
                pass
            arrived.clear()
            now = clock()
            for notice in silence.look(now, lambda: _silence(network, listener)):
                yield notice
            while not waiting.empty():
                topic, kind, content, at = waiting.get_nowait()
                try:
                    found = listener.take(topic, kind, content)
                except ProtocolError as error:
                    found = [error]
                for event in faults.events(found, at, address):
                    for notice in silence.hear(at) if isinstance(event, Arrival) else ():
                        yield notice
                    yield event
            if dropped[0] > lost:
                yield Notice(Level.WARNING, f"{address}: {dropped[0] - lost} messages dropped here", now)
                lost = dropped[0]
            several = _several(network, listener)
            if len(several) > shared:
                yield Notice(Level.WARNING, f"{address}: {'; '.join(several)}", now)
            shared = len(several)
    finally:
        network.close()


def _several(network: Network, listener: Listener) -> list[str]:
    """Return what to say about topics with several publishers."""
    texts = []
    for topic in listener.topics:
        count = sum(one.topic == topic for one in list(network.publishers.values()))
        if count > 1 and topic not in ("/tf", _STATIC, "/joint_states"):
            texts.append(f"{topic} has {count} publishers; their messages are taken for those of one device")
    return texts


def _silence(network: Network, listener: Listener) -> str:
    """Return what to say when nothing is received: which topics there are instead."""
    if network.failure:
        return f"the network can no longer be read ({network.failure}); begin again"
    publishers = list(network.publishers.values())
    there = {one.topic for one in publishers}
    missing = [topic for topic in listener.topics if topic not in there and topic != _STATIC]
    foreign = [one for one in publishers if one.topic in listener.topics and one.kind not in listener.kinds]
    if foreign:
        one = foreign[0]
        return f"{one.topic} has messages of type {one.kind}, expected {' or '.join(sorted(listener.kinds))}"
    if not missing:
        return f"nothing is received on {', '.join(listener.topics)}, which somebody publishes"
    others = sorted({f"{one.topic} ({one.kind})" for one in publishers if one.kind in listener.kinds})
    text = f"nobody publishes {', '.join(missing)}"
    if others:
        return f"{text}; topics that would do: {', '.join(others)}"
    if publishers:
        return f"{text}; topics that are published: {', '.join(sorted(there)[:10])}"
    return f"{text}; nobody was found in this domain: are its number and the network interface right?"

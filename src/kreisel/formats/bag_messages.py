"""The messages of a bag as numbers: stamps of the headers, keys of the bodies, and rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kreisel.errors import RecordingError, reason
from kreisel.formats.topic_names import FRAMES, IMU, JOINTS, NOTE_TYPE

if TYPE_CHECKING:
    from kreisel.formats.mcap import Topic
    from kreisel.geometry.rotation import Array
    from kreisel.recording.recording import Stamps

POINT = "geometry_msgs/msg/PointStamped"
TURN = "geometry_msgs/msg/QuaternionStamped"
_STORES = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}


def _vector(v: Any) -> tuple[float, ...]:
    return (v.x, v.y, v.z)


def _turn(q: Any) -> tuple[float, ...]:
    return (q.w, q.x, q.y, q.z)


def _imu_row(message: Any) -> tuple[float, ...]:
    """Return rates, accelerations and the two covariance entries that are -1 where there are none."""
    marks = (message.angular_velocity_covariance[0], message.linear_acceleration_covariance[0])
    return (*_vector(message.angular_velocity), *_vector(message.linear_acceleration), *marks)


def _pose_row(pose: Any) -> tuple[float, ...]:
    return (*_vector(pose.position), *_turn(pose.orientation))


def _transform_row(message: Any) -> tuple[float, ...]:
    return (*_vector(message.transform.translation), *_turn(message.transform.rotation))


REFERENCE_ROWS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: _pose_row(message.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: _pose_row(message.pose.pose),
    "geometry_msgs/msg/TransformStamped": _transform_row,
    "nav_msgs/msg/Odometry": lambda message: _pose_row(message.pose.pose),
    POINT: lambda message: _vector(message.point),
    TURN: lambda message: _turn(message.quaternion),
}
_ROWS: dict[str, Callable[[Any], tuple[float, ...]]] = {
    IMU: _imu_row,
    JOINTS: lambda message: tuple(message.position),
    **REFERENCE_ROWS,
}

WANTED = frozenset({*_ROWS, NOTE_TYPE})
"""Message types that a recording uses."""

_DAMAGED = "the file is damaged there; record again, or remove these messages"

Decoded: TypeAlias = "tuple[Stamps, list[str], Sequence[Sequence[float]] | Array]"
Decode: TypeAlias = "Callable[[Topic, Path], Decoded]"


@cache
def deserializer(encoding: str) -> Callable[[bytes, str], Any]:
    """Return the function of a message's bytes and type that returns its fields."""
    store = get_typestore(_STORES[encoding])
    for name in FRAMES:
        if name not in store.types:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr


def decode_topic(topic: Topic, path: Path) -> Decoded:
    """Return the headers' stamps, the keys of the bodies, and rows of numbers."""
    deserialize, row = deserializer(topic.encoding), _ROWS[topic.msgtype]
    stamps, keys, rows = [], [], []
    with translated(path, _DAMAGED, f"a message on {topic.name}"):
        for payload in topic.payloads:
            message = deserialize(payload, topic.msgtype)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            keys.append(_key(message))
            rows.append(row(message))
        return np.array(stamps, dtype=np.int64), keys, rows


def _key(message: Any) -> str:
    """Return the key that distinguishes bodies on one topic: frame id, or the child's, or the joints' names."""
    if hasattr(message, "position") and hasattr(message, "effort"):
        return ", ".join(message.name)
    return getattr(message, "child_frame_id", "") or str(message.header.frame_id)


def decode_frames(topic: Topic, path: Path) -> list[tuple[int, str, str, tuple[float, ...]]]:
    """Return stamp, parent, child, and position and quaternion of each frame in the messages of a topic, as they came.

    Raises
    ------
    RecordingError
        If a message is damaged.
    """
    deserialize = deserializer(topic.encoding)
    frames = []
    with translated(path, _DAMAGED, f"a message on {topic.name}"):
        for payload in topic.payloads:
            for one in deserialize(payload, topic.msgtype).transforms:
                head = one.header
                stamp = head.stamp.sec * 10**9 + head.stamp.nanosec
                parent, child = (name.removeprefix("/") for name in (head.frame_id, one.child_frame_id))
                frames.append((stamp, parent, child, _transform_row(one)))
    return frames


@contextmanager
def translated(path: Path, advice: str, where: str = "") -> Iterator[None]:
    """Turn any exception of a library about a damaged file into one line that names the file."""
    try:
        yield
    except Exception as error:
        raise RecordingError(f"{where or 'it'} cannot be read: {reason(error)}; {advice}", file=path) from error

"""The topics that kreisel writes, and the types of messages."""

from __future__ import annotations

import re

IMU_TOPIC = "/imu/data_raw"
POSE_TOPIC = "/robot/pose"
POSITION_TOPIC = "/robot/position"
ORIENTATION_TOPIC = "/robot/orientation"
JOINT_TOPIC = "/robot/joint_states"
NOTE_TOPIC = "/kreisel/notes"
"""Topic of events during recording: devices lost and reconnected, jumps of clocks."""

IMU = "sensor_msgs/msg/Imu"
JOINTS = "sensor_msgs/msg/JointState"
NOTE_TYPE = "rcl_interfaces/msg/Log"
FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of messages with the frames of a system, the second of ROS 1 in its early years."""

ENCODINGS = ("cdr", "ros1")
"""Of messages that can be decoded."""


_OF_A_FURTHER_UNIT = re.compile(r"/imu[1-9][0-9]*/data_raw(_[0-9]+)?")


def topic_of(unit: int) -> str:
    """Return the topic of a unit's readings: /imu/data_raw of the first, then /imu1/data_raw, …."""
    return f"/imu{unit}/data_raw" if unit else IMU_TOPIC


def is_of_a_further_unit(topic: str) -> bool:
    """Return whether a topic is one of readings of a unit after the first."""
    return _OF_A_FURTHER_UNIT.fullmatch(topic) is not None

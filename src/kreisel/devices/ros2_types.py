"""Types of ROS 2 messages as Cyclone DDS describes them on the network; contents stay bytes, see `protocols.ros2`."""

# mypy: disable-error-code="valid-type,type-arg"

from dataclasses import dataclass
from typing import Any

from cyclonedds import idl
from cyclonedds.idl.types import array, float64, int32, sequence, uint32

from kreisel.protocols import ros2


@dataclass
class _Time(idl.IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class _Header(idl.IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: _Time
    frame_id: str


@dataclass
class _Vector(idl.IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class _Point(idl.IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class _Quaternion(idl.IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class _Pose(idl.IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: _Point
    orientation: _Quaternion


@dataclass
class _Transform(idl.IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: _Vector
    rotation: _Quaternion


@dataclass
class _Imu(idl.IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: _Header
    orientation: _Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: _Vector
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: _Vector
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class _JointState(idl.IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: _Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class _PoseStamped(idl.IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: _Header
    pose: _Pose


@dataclass
class _TransformStamped(idl.IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: _Header
    child_frame_id: str
    transform: _Transform


@dataclass
class _TFMessage(idl.IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[_TransformStamped]


def with_content(kind: Any, data: bytes) -> Any:
    """Return a message of a type with a content as it is on the network."""
    message = kind.__new__(kind)
    message.data = data
    return message


def _kept(kind: Any) -> Any:
    """Return a type whose content comes as bytes: Cyclone's own conversion takes 24 us, three times as long."""
    kind.serialize = lambda message, *_, **__: message.data
    kind.deserialize = classmethod(lambda cls, data, *_, **__: with_content(cls, bytes(data)))
    return kind


TYPES: dict[str, Any] = {
    ros2.IMU: _kept(_Imu),
    ros2.JOINTS: _kept(_JointState),
    ros2.POSE: _kept(_PoseStamped),
    ros2.TRANSFORM: _kept(_TransformStamped),
    ros2.FRAMES: _kept(_TFMessage),
}
"""Types by the names that ROS 2 shows to people; see `with_content`."""


def shown(typename: str) -> str:
    """Return the name that ROS 2 shows to people for a type on the network."""
    return typename.replace("::dds_::", "/").replace("::", "/").removesuffix("_")

"""Universal Robots' Real-Time Data Exchange: packages over TCP, big-endian, their size first.

A client asks for protocol version 2, names the fields it wants and how often, starts, and is then sent data packages.
Nothing the client sends can move the robot. Poses are m and a rotation vector; stamps are seconds since the controller
was started.
"""

from __future__ import annotations

import math
import struct
from enum import Enum, auto

from kreisel.errors import ProtocolError
from kreisel.protocols.framing import Splitter
from kreisel.protocols.samples import Quadruple, RobotSample, Triple, checked_stamp, finite

FIELDS = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_TCP_pose": "VECTOR6D"}
"""What the client asks for."""

LARGEST = 4096
"""Bytes a package may have."""

_NAME = "RTDE"
_HEAD = struct.Struct(">HB")
_VERSION, _TEXT, _CONTROLLER, _DATA = b"VMvU"
_OUTPUTS, _INPUTS, _START, _PAUSE = b"OISP"
_SIZES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
    "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip


def _splitter() -> Splitter:
    return Splitter(_NAME, ">HB", length=0, least=_HEAD.size, most=LARGEST, whole=True)


def package(kind: int, payload: bytes = b"") -> bytes:
    """Return a package."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


class State(Enum):
    """How far a client has come."""

    VERSION = auto()
    OUTPUTS = auto()
    START = auto()
    RUNNING = auto()


class Client:
    """The client's side of one connection.

    Parameters
    ----------
    frequency
        Packages a second wanted; a controller gives its own rate at most.
    """

    def __init__(self, frequency: float) -> None:
        self.state = State.VERSION
        self._frequency = frequency
        self._splitter = _splitter()
        self._recipe = 0

    def begin(self) -> bytes:
        """Return what to send first."""
        return package(_VERSION, struct.pack(">H", 2))

    def receive(self, data: bytes) -> tuple[list[RobotSample], bytes, list[str]]:
        """Return poses, what to send next, and messages of the controller.

        Raises
        ------
        ProtocolError
            If the controller refuses, or the stream is out of step.
        """
        samples, answer, texts = [], b"", []
        for kind, payload in self._splitter.receive(data):
            if kind == _TEXT:
                texts.append(_text(payload))
            elif kind == _DATA and self.state is State.RUNNING:
                samples.append(self._sample(payload))
            elif kind != _DATA:
                answer += self._advance(kind, payload)
        return samples, answer, texts

    def _advance(self, kind: int, payload: bytes) -> bytes:
        if self.state is State.VERSION and kind == _VERSION:
            if payload != b"\x01":
                raise ProtocolError(_NAME, "the controller refuses protocol version 2: is its software older than 3.4?")
            self.state = State.OUTPUTS
            return package(_OUTPUTS, struct.pack(">d", self._frequency) + ",".join(FIELDS).encode())
        if self.state is State.OUTPUTS and kind == _OUTPUTS:
            self._check_types(payload)
            self.state = State.START
            return package(_START)
        if self.state is State.START and kind == _START:
            if payload != b"\x01":
                raise ProtocolError(_NAME, "the controller refuses to start sending")
            self.state = State.RUNNING
            return b""
        raise ProtocolError(_NAME, f"package '{chr(kind)}' while waiting for {self.state.name.lower()}")

    def _check_types(self, payload: bytes) -> None:
        types = payload[1:].decode("ascii", "replace").split(",")
        if not payload or types != list(FIELDS.values()):
            given = dict(zip(FIELDS, types, strict=False))
            raise ProtocolError(_NAME, f"the controller gives {given}, expected {FIELDS}")
        self._recipe = payload[0]

    def _sample(self, payload: bytes) -> RobotSample:
        if len(payload) != 1 + 8 * 13 or payload[0] != self._recipe:
            raise ProtocolError(_NAME, f"data of {len(payload)} bytes, expected {1 + 8 * 13} of recipe {self._recipe}")
        values = finite(struct.unpack(">13d", payload[1:]), _NAME, "a field")
        if abs(values[0]) > 2.0**31:
            raise ProtocolError(_NAME, f"the time stamp {values[0]:g} s is impossible")
        if max(map(abs, values[10:13])) > 4.0 * math.pi:
            raise ProtocolError(
                _NAME, f"the rotation vector {values[10:13]} is longer than a turn, expected pi at most"
            )
        stamp_ns = checked_stamp(round(values[0] * 1e9), _NAME)
        return RobotSample(
            stamp_ns, (values[7], values[8], values[9]), from_rotation_vector(values[10:13]), values[1:7]
        )


class Server:
    """The controller's side of one connection: the twin.

    Attributes
    ----------
    fields
        Names asked for; the values of those it does not know are zero.
    streaming
        Whether data are to be sent.
    frequency
        Packages a second asked for.
    """

    _RECIPE = 1

    def __init__(self, version: tuple[int, int, int, int] = (5, 11, 0, 0)) -> None:
        self.fields: list[str] = []
        self.streaming = False
        self.frequency = 500.0
        self._version = version
        self._splitter = _splitter()

    def receive(self, data: bytes) -> bytes:
        """Return what to answer.

        Raises
        ------
        ProtocolError
            If the stream is out of step.
        """
        return b"".join(self._answer(kind, payload) for kind, payload in self._splitter.receive(data))

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == _VERSION:
            return package(kind, b"\x01" if payload in (b"\x00\x02", b"\x00\x01") else b"\x00")
        if kind == _CONTROLLER:
            return package(kind, struct.pack(">4I", *self._version))
        if kind == _OUTPUTS:
            if len(payload) < 8:
                raise ProtocolError(_NAME, f"recipe of {len(payload)} bytes, expected 8 or more")
            (self.frequency,) = struct.unpack_from(">d", payload)
            self.fields = _names(payload[8:])
            return package(kind, bytes([self._RECIPE]) + ",".join(type_of(name) for name in self.fields).encode())
        if kind == _INPUTS:
            return package(kind, bytes([self._RECIPE]) + ",".join(map(type_of, _names(payload))).encode())
        if kind in (_START, _PAUSE):
            self.streaming = kind == _START
            return package(kind, b"\x01")
        return b""

    def encode(self, sample: RobotSample) -> bytes:
        """Return the data package of a pose."""
        known: dict[str, tuple[float, ...]] = {"timestamp": (sample.stamp_ns * 1e-9,)}
        if sample.joints:
            known["actual_q"] = known["target_q"] = sample.joints
        if sample.position is not None and sample.quaternion is not None:
            known["actual_TCP_pose"] = (*sample.position, *to_rotation_vector(sample.quaternion))
            known["target_TCP_pose"] = known["actual_TCP_pose"]
        known["robot_mode"], known["safety_mode"], known["runtime_state"] = (7,), (1,), (2,)
        payload = bytes([self._RECIPE])
        for name in self.fields:
            layout = struct.Struct(">" + _SIZES.get(type_of(name), ""))
            count = len(layout.unpack(bytes(layout.size)))
            payload += layout.pack(*known.get(name, (0,) * count))
        return package(_DATA, payload)


_OTHERS = {
    "actual_digital_input_bits": "UINT64", "actual_digital_output_bits": "UINT64", "robot_mode": "INT32",
    "safety_mode": "INT32", "safety_status": "INT32", "runtime_state": "UINT32", "joint_mode": "VECTOR6INT32",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32", "output_bit_registers0_to_31": "UINT32",
    "output_bit_registers32_to_63": "UINT32", "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32", "actual_tool_accelerometer": "VECTOR3D", "payload_cog": "VECTOR3D",
    "tool_analog_input_types": "UINT32", "standard_analog_input0": "DOUBLE", "standard_analog_input1": "DOUBLE",
    "standard_analog_output0": "DOUBLE", "standard_analog_output1": "DOUBLE", "speed_slider_mask": "UINT32",
    "standard_digital_output_mask": "UINT8", "standard_digital_output": "UINT8", "standard_analog_output_mask": "UINT8",
    "configurable_digital_output_mask": "UINT8", "configurable_digital_output": "UINT8",
    "standard_analog_output_type": "UINT8", "tool_digital_output_mask": "UINT8", "tool_digital_output": "UINT8",
}  # fmt: skip
_VECTORS = (
    "target_q", "target_qd", "target_qdd", "target_current", "target_moment", "actual_q", "actual_qd", "actual_qdd",
    "actual_current", "actual_current_as_torque", "actual_moment", "joint_control_output", "actual_TCP_pose",
    "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed", "joint_temperatures",
    "actual_joint_voltage", "ft_raw_wrench", "payload_inertia",
)  # fmt: skip
_NUMBERS = (
    "timestamp", "actual_execution_time", "speed_scaling", "target_speed_fraction", "actual_momentum",
    "actual_main_voltage", "actual_robot_voltage", "actual_robot_current", "payload", "speed_slider_fraction",
)  # fmt: skip


def type_of(name: str) -> str:
    """Return the type a controller gives a field, or NOT_FOUND."""
    if name in _VECTORS:
        return "VECTOR6D"
    if name in _NUMBERS or "_double_register_" in name:
        return "DOUBLE"
    if "_int_register_" in name:
        return "INT32"
    return "BOOL" if "_bit_register_" in name else _OTHERS.get(name, "NOT_FOUND")


def from_rotation_vector(theta: tuple[float, ...]) -> Quadruple:
    """Return the quaternion of a rotation vector, rad."""
    x, y, z = theta
    angle = math.sqrt(x * x + y * y + z * z)
    k = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), k * x, k * y, k * z)


def to_rotation_vector(q: Quadruple) -> Triple:
    """Return the rotation vector of a unit quaternion, at most pi long."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    length = math.sqrt(x * x + y * y + z * z)
    k = 2.0 if length < 1e-12 else 2.0 * math.atan2(length, w) / length
    return (k * x, k * y, k * z)


def _names(payload: bytes) -> list[str]:
    """Return names divided by commas; clients in use end with one."""
    return [name for name in payload.decode("ascii", "replace").split(",") if name]


def _text(payload: bytes) -> str:
    """Return a message of the controller: text, source and level."""
    if not payload:
        return "an empty message"
    return payload[1 : 1 + payload[0]].decode("latin-1") or "an empty message"

"""Universal Robots' Real-Time Data Exchange: packages over TCP, big-endian, that begin with their size.

A client requests protocol version 2, then the fields and their frequency, then the start; the controller then sends
data packages. Nothing the client sends can move the robot. Poses are m and a rotation vector; stamps are seconds since
the controller was started.
"""

from __future__ import annotations

import math
import struct
from enum import Enum, auto

from kreisel.errors import ProtocolError
from kreisel.protocols.framing import Splitter
from kreisel.protocols.samples import Quadruple, RobotSample, Triple, checked_stamp, finite

FIELDS = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "actual_TCP_pose": "VECTOR6D"}
"""Fields the client needs."""

STATES = ("safety_status", "safety_mode", "robot_mode", "runtime_state")
"""Further fields the client asks for; controllers with older software do not have all of them."""

SAFETY = {
    3: "protective stop", 4: "recovery mode", 5: "safeguard stop", 6: "system emergency stop",
    7: "robot emergency stop", 8: "safety violation", 9: "safety fault", 10: "validation of a joint's id",
    11: "undefined safety mode", 12: "safeguard stop in automatic mode", 13: "three-position enabling stop",
}  # fmt: skip
"""Safety states other than normal (1) and reduced (2); 0 is none of them, and is not reported by a controller."""

MODES = {
    -1: "no controller", 0: "disconnected", 1: "safety to be confirmed", 2: "booting", 3: "power off", 4: "power on",
    5: "idle", 6: "backdrive", 8: "updating firmware",
}  # fmt: skip
"""Robot modes other than running (7)."""

STOPPED = 1
"""Runtime state in which the controller holds no program."""

PLAYING = (2, 5)
"""Runtime states in which a program runs: playing, resuming."""

MAX_BYTES = 4096
"""Largest number of bytes of a package."""

_NAME = "RTDE"
_RUNNING = 7  # robot_mode of an arm that can move, by the fields of RTDE; see `MODES`
_INTEGERS = ("UINT8", "INT32", "UINT32")
_HEAD = struct.Struct(">HB")
VERSION, _TEXT, _CONTROLLER, DATA = b"VMvU"
OUTPUTS, INPUTS, START, _PAUSE = b"OISP"
_SIZES = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
    "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip


def package_splitter() -> Splitter:
    """Return what splits a stream into packages."""
    return Splitter(_NAME, ">HB", length=0, least=_HEAD.size, most=MAX_BYTES, whole=True)


def package(kind: int, payload: bytes = b"") -> bytes:
    """Return a package."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


class State(Enum):
    """What a client waits for, or that it runs."""

    VERSION = auto()
    OUTPUTS = auto()
    START = auto()
    RUNNING = auto()


class Client:
    """The client's side of one connection.

    Parameters
    ----------
    frequency
        Requested packages a second; a controller sends at its own rate at most.
    """

    def __init__(self, frequency: float) -> None:
        self.state = State.VERSION
        self._frequency = frequency
        self._splitter = package_splitter()
        self._recipe = 0
        self._states: tuple[str, ...] = STATES
        self._layout = struct.Struct(">13d")

    def begin(self) -> bytes:
        """Return what to send first."""
        return package(VERSION, struct.pack(">H", 2))

    def receive(self, data: bytes) -> tuple[list[RobotSample], bytes, list[str]]:
        """Return poses, what to send next, and messages of the controller.

        Raises
        ------
        ProtocolError
            If the controller refuses, or the position in the stream is lost.
        """
        samples, answer, texts = [], b"", []
        for kind, payload in self._splitter.receive(data):
            if kind == _TEXT:
                texts.append(_text(payload))
            elif kind == DATA and self.state is State.RUNNING:
                samples.append(self._sample(payload))
            elif kind != DATA:
                answer += self._advance(kind, payload)
        return samples, answer, texts

    def _advance(self, kind: int, payload: bytes) -> bytes:
        if self.state is State.VERSION and kind == VERSION:
            if payload != b"\x01":
                raise ProtocolError(_NAME, "the controller refuses protocol version 2: is its software older than 3.4?")
            self.state = State.OUTPUTS
            return self._ask_outputs()
        if self.state is State.OUTPUTS and kind == OUTPUTS:
            if not self._take_types(payload):
                return self._ask_outputs()
            self.state = State.START
            return package(START)
        if self.state is State.START and kind == START:
            if payload != b"\x01":
                raise ProtocolError(_NAME, "the controller refuses to start sending")
            self.state = State.RUNNING
            return b""
        raise ProtocolError(_NAME, f"package '{chr(kind)}' while waiting for {self.state.name.lower()}")

    def _ask_outputs(self) -> bytes:
        return package(OUTPUTS, struct.pack(">d", self._frequency) + ",".join((*FIELDS, *self._states)).encode())

    def _take_types(self, payload: bytes) -> bool:
        """Take the types of the requested fields; return True to start, False to ask again without missing fields."""
        types = payload[1:].decode("ascii", "replace").split(",")
        needed, others = types[: len(FIELDS)], types[len(FIELDS) :]
        if not payload or needed != list(FIELDS.values()):
            given = dict(zip(FIELDS, needed, strict=False))
            raise ProtocolError(_NAME, f"the controller sends {given}, expected {FIELDS}")
        whole = len(others) == len(self._states)
        found = tuple(name for name, kind in zip(self._states, others, strict=False) if whole and kind in _INTEGERS)
        if found != self._states:
            self._states = found
            return False
        self._layout = struct.Struct(">13d" + "".join(_SIZES[kind] for kind in others))
        self._recipe = payload[0]
        return True

    def _sample(self, payload: bytes) -> RobotSample:
        size = 1 + self._layout.size
        if len(payload) != size or payload[0] != self._recipe:
            raise ProtocolError(_NAME, f"data of {len(payload)} bytes, expected {size} of recipe {self._recipe}")
        fields = self._layout.unpack(payload[1:])
        values = finite(fields[:13], _NAME, "a field")
        if abs(values[0]) > 2.0**31:
            raise ProtocolError(_NAME, f"the time stamp {values[0]:g} s is impossible")
        if max(map(abs, values[10:13])) > 4.0 * math.pi:
            raise ProtocolError(_NAME, f"the rotation vector {values[10:13]} is longer than 4 pi, expected pi at most")
        stamp_ns = checked_stamp(round(values[0] * 1e9), _NAME)
        states = dict(zip(self._states, fields[13:], strict=True))
        runtime = states.get("runtime_state")
        running, holds = (None, None) if runtime is None else (runtime in PLAYING, runtime != STOPPED)
        return RobotSample(
            stamp_ns, (values[7], values[8], values[9]), from_rotation_vector(values[10:13]), values[1:7],
            blocked(states), running, holds,
        )  # fmt: skip


def blocked(states: dict[str, int]) -> str:
    """Return the state in which the arm must not or cannot move, in words; empty if there is none.

    Parameters
    ----------
    states
        Values of those of `STATES` that the controller reports.
    """
    for name in ("safety_status", "safety_mode"):
        value = states.get(name, 0)
        if value not in (0, 1, 2):
            return f"{SAFETY.get(value, 'a safety state')} ({name} {value})"
    mode = states.get("robot_mode", _RUNNING)
    return "" if mode == _RUNNING else f"{MODES.get(mode, 'another mode than running')} (robot_mode {mode})"


class Server:
    """The controller's side of one connection (simulator).

    Attributes
    ----------
    fields
        Names of the requested fields; unknown ones have the value zero.
    inputs
        Names of the inputs that the client writes.
    written
        Times that it has written them.
    streaming
        Whether data are sent.
    frequency
        Requested packages a second.
    """

    _RECIPE = 1

    def __init__(self, version: tuple[int, int, int, int] = (5, 11, 0, 0)) -> None:
        self.fields: list[str] = []
        self.inputs: list[str] = []
        self.written = 0
        self.streaming = False
        self.frequency = 500.0
        self._version = version
        self._splitter = package_splitter()

    def receive(self, data: bytes) -> bytes:
        """Return the answer.

        Raises
        ------
        ProtocolError
            If the position in the stream is lost.
        """
        return b"".join(self._answer(kind, payload) for kind, payload in self._splitter.receive(data))

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == VERSION:
            return package(kind, b"\x01" if payload in (b"\x00\x02", b"\x00\x01") else b"\x00")
        if kind == _CONTROLLER:
            return package(kind, struct.pack(">4I", *self._version))
        if kind == OUTPUTS:
            if len(payload) < 8:
                raise ProtocolError(_NAME, f"recipe of {len(payload)} bytes, expected 8 or more")
            (self.frequency,) = struct.unpack_from(">d", payload)
            self.fields = _names(payload[8:])
            return package(kind, bytes([self._RECIPE]) + ",".join(type_of(name) for name in self.fields).encode())
        if kind == INPUTS:
            self.inputs = _names(payload)
            return package(kind, bytes([self._RECIPE]) + ",".join(map(type_of, self.inputs)).encode())
        if kind == DATA and self.inputs:
            self.written += 1
        if kind in (START, _PAUSE):
            self.streaming = kind == START
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
        known["robot_mode"], known["runtime_state"] = (_RUNNING,), (PLAYING[0] if sample.running else STOPPED,)
        known["safety_mode"] = known["safety_status"] = (1,)
        payload = bytes([self._RECIPE])
        for name in self.fields:
            layout = struct.Struct(">" + _SIZES.get(type_of(name), ""))
            count = len(layout.unpack(bytes(layout.size)))
            payload += layout.pack(*known.get(name, (0,) * count))
        return package(DATA, payload)


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
    """Return the rotation vector of a unit quaternion; its length is at most pi."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    length = math.sqrt(x * x + y * y + z * z)
    k = 2.0 if length < 1e-12 else 2.0 * math.atan2(length, w) / length
    return (k * x, k * y, k * z)


def _names(payload: bytes) -> list[str]:
    """Return names separated by commas; some clients add a comma at the end."""
    return [name for name in payload.decode("ascii", "replace").split(",") if name]


def _text(payload: bytes) -> str:
    """Return the text of a controller's message, which holds text, source and level."""
    if not payload:
        return "an empty message"
    return payload[1 : 1 + payload[0]].decode("latin-1") or "an empty message"

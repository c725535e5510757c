"""MAVLink 1 and 2, the protocol of autopilots: frames over UDP, TCP or a serial line; the readings of their IMUs.

A frame of version 2 is 0xFD, length, two bytes of flags, sequence, system, component and three bytes of message
number, then the payload without its trailing zeros, a CRC-16/MCRF4XX of all but the first byte and of a byte that
belongs to the message's definition, and 13 bytes of signature if a flag says so. Version 1 is 0xFE, length, sequence,
system, component and one byte of message number. Numbers are little-endian, the largest first. Source: mavlink.io,
"Packet Serialization" and the definitions in `common.xml`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from kreisel.errors import ProtocolError
from kreisel.protocols.samples import ImuSample, checked_stamp, finite
from kreisel.units import MG

OURS = (245, 191)
"""How we name ourselves: a system's number of our choice, not that of a ground station (255), so that an autopilot does
not miss its operator when we end; component MAV_COMP_ID_ONBOARD_COMPUTER of `common.xml`."""

AUTOPILOT = (1, 1)
"""How autopilots name themselves unless they are configured: MAV_COMP_ID_AUTOPILOT1 of `common.xml`."""

ARDUPILOT = 3
"""MAV_AUTOPILOT_ARDUPILOTMEGA of `common.xml`; its RAW_IMU is in mg and mrad/s, that of others in counts."""

NO_AUTOPILOT = 8
"""MAV_AUTOPILOT_INVALID of `common.xml`: the sender flies nothing, for example a camera or a ground station."""

_NAME = "MAVLink"
_V1, _V2, _SIGNED = 0xFE, 0xFD, 0x01  # first bytes of a frame, and the flag of a signed one (mavlink.io)
_HEAD1, _HEAD2, _SIGNATURE = 6, 10, 13  # bytes
_MRAD = 1e-3  # rad/s
_INTERVAL = 511  # MAV_CMD_SET_MESSAGE_INTERVAL
_FULL_UPDATE = 0x3F  # HIGHRES_IMU_UPDATED_XACC to ..._ZGYRO
_RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 5: "in progress", 6: "cancelled"}
"""What an autopilot did not do, by the values of MAV_RESULT in `common.xml`."""


class Message(IntEnum):
    """Numbers of the messages that are understood."""

    HEARTBEAT = 0
    SCALED_IMU = 26
    RAW_IMU = 27
    COMMAND_LONG = 76
    COMMAND_ACK = 77
    HIGHRES_IMU = 105
    TIMESYNC = 111
    SCALED_IMU2 = 116
    SCALED_IMU3 = 129


@dataclass(frozen=True)
class _Layout:
    """Byte of the CRC that belongs to a definition, and the fields of a payload, those of extensions last."""

    extra: int
    fields: struct.Struct


_INTEGERS = "9h"
_LAYOUTS = {
    Message.HEARTBEAT: _Layout(50, struct.Struct("<I5B")),
    Message.SCALED_IMU: _Layout(170, struct.Struct(f"<I{_INTEGERS}h")),
    Message.RAW_IMU: _Layout(144, struct.Struct(f"<Q{_INTEGERS}Bh")),
    Message.COMMAND_LONG: _Layout(152, struct.Struct("<7fH3B")),
    Message.COMMAND_ACK: _Layout(143, struct.Struct("<HBBiBB")),
    Message.HIGHRES_IMU: _Layout(93, struct.Struct("<Q13fHB")),
    Message.TIMESYNC: _Layout(34, struct.Struct("<2q2B")),
    Message.SCALED_IMU2: _Layout(76, struct.Struct(f"<I{_INTEGERS}h")),
    Message.SCALED_IMU3: _Layout(46, struct.Struct(f"<I{_INTEGERS}h")),
}
"""Layouts by message; the CRC bytes follow from the definitions in `common.xml`."""

READINGS = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""Messages with the readings of an IMU."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: number of the message, its payload padded to the layout's size, sender, and count of its frames."""

    message: int
    payload: bytes
    system: int
    component: int
    sequence: int

    @property
    def values(self) -> tuple[float, ...]:
        """Return the fields of the payload, in the order of the layout."""
        return _LAYOUTS[Message(self.message)].fields.unpack(self.payload)


class Decoder:
    """Decodes the frames of a byte stream in chunks of any size; unknown messages are passed over.

    Attributes
    ----------
    skipped
        Number of bytes that belong to no frame.
    missing
        Number of lost frames of any message, by each sender's count.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self.missing = 0
        self._buffer = bytearray()
        self._sequence: dict[tuple[int, int], int] = {}

    def receive(self, data: bytes) -> list[Frame]:
        """Return the understood frames that are now complete."""
        self._buffer += data
        buffer, at, frames = self._buffer, 0, []
        while at < len(buffer):
            if buffer[at] not in (_V1, _V2):
                at += 1
                self.skipped += 1
                continue
            end = _end(buffer, at)
            if end is None or end > len(buffer):
                break
            frame = _frame(bytes(buffer[at:end]))
            if frame is None or (frame.message not in _LAYOUTS and end < len(buffer) and buffer[end] not in (_V1, _V2)):
                at += 1
                self.skipped += 1
                continue
            at = end
            self._count(frame)
            if frame.message in _LAYOUTS:
                frames.append(frame)
        del buffer[:at]
        return frames

    def _count(self, frame: Frame) -> None:
        sender = (frame.system, frame.component)
        before = self._sequence.get(sender)
        step = 1 if before is None else (frame.sequence - before) % 256
        if 0 < step < 128:  # else it came twice, or late
            self.missing += step - 1
            self._sequence[sender] = frame.sequence


def _end(buffer: bytearray, at: int) -> int | None:
    """Return where the frame that begins at a place ends, or None if its head is not complete."""
    if len(buffer) - at < 3:
        return None
    if buffer[at] == _V1:
        return at + _HEAD1 + buffer[at + 1] + 2
    return at + _HEAD2 + buffer[at + 1] + 2 + (_SIGNATURE if buffer[at + 2] & _SIGNED else 0)


def _frame(data: bytes) -> Frame | None:
    """Return the frame of all its bytes, None if it is damaged; the CRC of an unknown message cannot be checked."""
    length = data[1]
    if data[0] == _V1:
        head, (sequence, system, component, number) = _HEAD1, data[2:6]
    elif data[2] & ~_SIGNED:  # a flag that must be understood
        return None
    else:
        head, (sequence, system, component), number = _HEAD2, data[4:7], int.from_bytes(data[7:10], "little")
    payload = data[head : head + length]
    layout = _LAYOUTS.get(number)  # type: ignore[call-overload]
    if layout is None:
        return Frame(number, payload, system, component, sequence)
    stated = int.from_bytes(data[head + length : head + length + 2], "little")
    if crc(data[1 : head + length] + bytes([layout.extra])) != stated:
        return None
    payload = payload[: layout.fields.size].ljust(layout.fields.size, b"\0")
    return Frame(number, payload, system, component, sequence)


def sample(frame: Frame, *, ardupilot: bool) -> ImuSample | None:
    """Return the reading of a frame with one of the `READINGS`; None if it has no new reading of all six axes.

    Parameters
    ----------
    ardupilot
        Whether the autopilot is ArduPilot; see `ARDUPILOT`.

    Raises
    ------
    ProtocolError
        If a value is impossible, or the unit of a RAW_IMU is not known.
    """
    values = frame.values
    time = int(values[0])
    if frame.message == Message.HIGHRES_IMU:
        if int(values[14]) and int(values[14]) & _FULL_UPDATE != _FULL_UPDATE:
            return None
        reading = finite(values[1:7], _NAME, "a reading")
        return ImuSample(checked_stamp(time * 1000, _NAME), _triple(reading[3:]), _triple(reading[:3]))
    unit = 1_000 if frame.message == Message.RAW_IMU else 1_000_000  # ns; the others count milliseconds
    if frame.message == Message.RAW_IMU and not ardupilot:
        raise ProtocolError(
            _NAME, "RAW_IMU of an autopilot that is not ArduPilot is in counts of unknown size; record HIGHRES_IMU"
        )
    accelerations, rates = (value * MG for value in values[1:4]), (value * _MRAD for value in values[4:7])
    return ImuSample(checked_stamp(time * unit, _NAME), _triple(tuple(rates)), _triple(tuple(accelerations)))


def _triple(values: tuple[float, ...]) -> tuple[float, float, float]:
    return values[0], values[1], values[2]


def encode(message: Message, values: tuple[float, ...], sequence: int, *, sender: tuple[int, int] = OURS) -> bytes:
    """Return a frame of version 2 with the fields of a layout."""
    layout = _LAYOUTS[message]
    payload = layout.fields.pack(*values).rstrip(b"\0") or b"\0"
    body = bytes([len(payload), 0, 0, sequence % 256, *sender]) + int(message).to_bytes(3, "little") + payload
    return bytes([_V2]) + body + crc(body + bytes([layout.extra])).to_bytes(2, "little")


def encode_sample(reading: ImuSample, sequence: int) -> bytes:
    """Return the HIGHRES_IMU frame of a reading (simulator's side)."""
    values = (reading.stamp_ns // 1000, *reading.acceleration, *reading.rate, *(0.0,) * 7, _FULL_UPDATE, 0)
    return encode(Message.HIGHRES_IMU, values, sequence, sender=AUTOPILOT)


def heartbeat(sequence: int, *, autopilot: int | None = None) -> bytes:
    """Return our sign of life, or that of an autopilot of a kind (simulator's side)."""
    if autopilot is None:  # MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE, version 3
        return encode(Message.HEARTBEAT, (0, 18, 8, 0, 4, 3), sequence)
    return encode(Message.HEARTBEAT, (0, 2, autopilot, 0, 3, 3), sequence, sender=AUTOPILOT)


def request(message: Message, rate: float, to: tuple[int, int], sequence: int) -> bytes:
    """Return the command that makes an autopilot send a message, `rate` times a second. It moves nothing."""
    values = (float(message), 1e6 / rate, 0.0, 0.0, 0.0, 0.0, 0.0, _INTERVAL, *to, 0)
    return encode(Message.COMMAND_LONG, values, sequence)


def requested(frame: Frame) -> tuple[int, float] | None:
    """Return the message and the rate, 1/s, that a frame requests; None if it requests none (simulator's side)."""
    if frame.message != Message.COMMAND_LONG or frame.values[7] != _INTERVAL or not frame.values[1] > 0.0:
        return None
    return int(frame.values[0]), 1e6 / frame.values[1]


def refusal(frame: Frame) -> str | None:
    """Return why an autopilot refuses `request`, None if the frame is another one."""
    if frame.message != Message.COMMAND_ACK or frame.values[0] != _INTERVAL or not frame.values[1]:
        return None
    return _RESULTS.get(int(frame.values[1]), f"result {frame.values[1]}")


def acknowledge(result: int, sequence: int) -> bytes:
    """Return an autopilot's answer to `request`; 0 accepts (simulator's side)."""
    return encode(Message.COMMAND_ACK, (_INTERVAL, result, 0, 0, *OURS), sequence, sender=AUTOPILOT)


def ask_time(host_ns: int, sequence: int) -> bytes:
    """Return the request for an autopilot's time; its answer returns `host_ns`."""
    return encode(Message.TIMESYNC, (0, host_ns, 0, 0), sequence)


def asks_time(frame: Frame) -> bool:
    """Return whether a frame is the request that `ask_time` makes (simulator's side)."""
    return frame.message == Message.TIMESYNC and not frame.values[0]


def answer_time(frame: Frame, stamp_ns: int, sequence: int) -> bytes:
    """Return an autopilot's answer to `ask_time` (simulator's side)."""
    return encode(Message.TIMESYNC, (stamp_ns, int(frame.values[1]), 0, 0), sequence, sender=AUTOPILOT)


def stated_time(frame: Frame) -> tuple[int, int] | None:
    """Return the autopilot's time and ours at the request, ns, if the frame answers `ask_time`."""
    if frame.message != Message.TIMESYNC or not frame.values[0]:
        return None
    return int(frame.values[0]), int(frame.values[1])


def _folded(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0x8408 if byte & 1 else 0)
    return byte


_FOLDED = tuple(map(_folded, range(256)))


def crc(data: bytes) -> int:
    """Return the CRC-16/MCRF4XX (polynomial 0x1021 reflected, start 0xFFFF)."""
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ _FOLDED[(value ^ byte) & 0xFF]
    return value

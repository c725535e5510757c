"""iXCOM, the protocol of iMAR's inertial systems: frames over TCP.

A frame is a header of 16 bytes (sync byte 0x7E, message, counter, length, GPS week, seconds and microseconds of the
week, little-endian), the payload, a status word and a CRC-16 (polynomial 0x1021, start 0) of all bytes before it.
IMURAW carries 3 x float32 acceleration, m/s^2, and 3 x float32 angular rate, rad/s.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass

from kreisel.errors import ProtocolError
from kreisel.protocols.samples import ImuSample, checked_stamp, finite

SYNC = 0x7E  # first byte of a frame
IMURAW, COMMAND, RESPONSE = 0x00, 0xFD, 0xFE  # kinds of messages, as in ixcom 1.3.10, iMAR's own client
CHANNEL = 5
"""Command that opens (1) or closes (0) a channel."""

LOG = 0
"""Command that adds a periodic message to the channel; its period is a number of samples."""

_NAME = "iXCOM"
_HEADER = struct.Struct("<BBBBHHII")
_BOTTOM = struct.Struct("<HH")
_IMU = struct.Struct("<6f")
_LOG = struct.Struct("<HHBBHH")
_MIN_LENGTH, _MAX_LENGTH = _HEADER.size + _BOTTOM.size, 4096  # bytes of a frame; 4096 is chosen: IMURAW has 44
_WEEK = 7 * 24 * 3600  # s


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: its message type, payload, and the device's time."""

    message: int
    payload: bytes
    stamp_ns: int
    counter: int


class Decoder:
    """Decodes the frames of a byte stream in chunks of any size; bytes outside frames are skipped and counted.

    Attributes
    ----------
    skipped
        Number of bytes that belong to no frame.
    missing
        Number of lost frames, by the counter.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self.missing = 0
        self._buffer = bytearray()
        self._counter: dict[int, int] = {}

    def receive(self, data: bytes) -> list[Frame]:
        """Return the frames that are now complete."""
        self._buffer += data
        frames = []
        buffer, at = self._buffer, 0
        while True:
            start = buffer.find(SYNC, at)
            if start < 0:
                self.skipped += len(buffer) - at
                at = len(buffer)
                break
            self.skipped += start - at
            at = start
            if len(buffer) - at < _HEADER.size:
                break
            length = int.from_bytes(buffer[at + 4 : at + 6], "little")
            if not _MIN_LENGTH <= length <= _MAX_LENGTH:
                at += 1
                self.skipped += 1
                continue
            if len(buffer) - at < length:
                break
            frame = bytes(buffer[at : at + length])
            if crc(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
                at += 1
                self.skipped += 1
                continue
            frames.append(self._frame(frame))
            at += length
        del buffer[:at]
        return frames

    def _frame(self, frame: bytes) -> Frame:
        _, message, counter, _, _, week, seconds, microseconds = _HEADER.unpack_from(frame)
        before = self._counter.get(message)
        if before is not None:
            self.missing += (counter - before - 1) % 256
        self._counter[message] = counter
        stamp_ns = (week * _WEEK + seconds) * 1_000_000_000 + microseconds * 1000
        return Frame(message, frame[_HEADER.size : -_BOTTOM.size], stamp_ns, counter)


def sample(frame: Frame) -> ImuSample:
    """Return the reading of an IMURAW frame.

    Raises
    ------
    ProtocolError
        If the payload has another length, or is not finite.
    """
    if len(frame.payload) != _IMU.size:
        raise ProtocolError(_NAME, f"IMURAW of {len(frame.payload)} bytes, expected {_IMU.size}")
    values = finite(_IMU.unpack(frame.payload), _NAME, "a reading")
    return ImuSample(
        checked_stamp(frame.stamp_ns, _NAME), (values[3], values[4], values[5]), (values[0], values[1], values[2])
    )


def check_response(frame: Frame) -> None:
    """Raise an error if a response is not 'OK'.

    Raises
    ------
    ProtocolError
        With the device's response number and text.
    """
    if len(frame.payload) < 4:
        raise ProtocolError(_NAME, f"response of {len(frame.payload)} bytes, expected 4 or more")
    number, _ = struct.unpack_from("<HH", frame.payload)
    if number:
        text = frame.payload[4:].split(b"\0")[0].decode("latin-1")
        raise ProtocolError(_NAME, f"the device refuses: {text or 'no reason given'} (response {number})")


def encode(message: int, payload: bytes, stamp_ns: int, counter: int) -> bytes:
    """Return a frame."""
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    week, seconds = divmod(seconds, _WEEK)
    length = _MIN_LENGTH + len(payload)
    body = _HEADER.pack(SYNC, message, counter % 256, 0, length, week, seconds, rest // 1000) + payload
    body += struct.pack("<H", 0)
    return body + struct.pack("<H", crc(body))


def encode_sample(reading: ImuSample, counter: int) -> bytes:
    """Return the IMURAW frame of a reading."""
    return encode(IMURAW, _IMU.pack(*reading.acceleration, *reading.rate), reading.stamp_ns, counter)


def open_channel(channel: int, counter: int = 0) -> bytes:
    """Return the command that opens a channel."""
    return encode(COMMAND, struct.pack("<HHHH", CHANNEL, 0, 1, channel), 0, counter)


def add_log(message: int, divider: int, counter: int = 1) -> bytes:
    """Return the command that requests a message once per `divider` samples."""
    return encode(COMMAND, _LOG.pack(LOG, 0, message, 0, 0, divider), 0, counter)


def wanted_log(frame: Frame) -> tuple[int, int] | None:
    """Return the requested message and divider, or None for any other command (simulator's side)."""
    if frame.message != COMMAND or len(frame.payload) != _LOG.size:
        return None
    command, _, message, _, action, divider = _LOG.unpack(frame.payload)
    return (message, max(1, divider)) if command == LOG and action == 0 else None


def respond(number: int, text: str, counter: int) -> bytes:
    """Return a response (simulator's side)."""
    content = text.encode("latin-1", "replace")
    return encode(RESPONSE, struct.pack("<HH", number, len(content)) + content, 0, counter)


def crc(data: bytes) -> int:
    """Return the CRC-16 of a frame without its last two bytes."""
    return binascii.crc_hqx(data, 0)

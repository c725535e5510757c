"""A heartbeat over RTDE: one input register that is written again and again, for a watchdog in the robot's program.

The client requests protocol version 2, the register as an input, one output (a controller starts with outputs only),
and the start; from then on it writes the register. A register that another client writes is refused with IN_USE.
"""

from __future__ import annotations

import struct

from kreisel.errors import ProtocolError
from kreisel.protocols import rtde

RATE = 50.0
"""Times a second that the register is written. Chosen: a watchdog of 10 Hz hears it although four in a row are late."""

_NAME = "RTDE"
_BEAT = struct.Struct(">Bi")
_IN_USE = "IN_USE"
_COUNTS = 1 << 30
"""Values of the register before it begins anew."""


class Heartbeat:
    """The client's side of one connection that writes an INT32 register.

    Attributes
    ----------
    running
        Whether the controller takes what is written.
    unsupported
        Why the controller has no such heartbeat; empty while it is not known to have none.
    """

    def __init__(self, register: str) -> None:
        self.running = False
        self.unsupported = ""
        self._register = register
        self._splitter = rtde.package_splitter()
        self._recipe = self._count = 0

    def begin(self) -> bytes:
        """Return what to send first."""
        return rtde.package(rtde.VERSION, struct.pack(">H", 2))

    def receive(self, data: bytes) -> bytes:
        """Return what to send next.

        Raises
        ------
        ProtocolError
            If another client writes the register, or the position in the stream is lost.
        """
        return b"".join(self._answer(kind, payload) for kind, payload in self._splitter.receive(data))

    def beat(self) -> bytes:
        """Return the package that writes the register once more, with another value."""
        self._count = (self._count + 1) % _COUNTS
        return rtde.package(rtde.DATA, _BEAT.pack(self._recipe, self._count))

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == rtde.VERSION:
            if payload != b"\x01":
                self.unsupported = "it refuses protocol version 2"
                return b""
            return rtde.package(rtde.INPUTS, self._register.encode())
        if kind == rtde.INPUTS:
            types = payload[1:].decode("ascii", "replace")
            if types == _IN_USE:
                raise ProtocolError(_NAME, f"another program writes {self._register}")
            if types != "INT32" or not payload[0]:
                self.unsupported = f"it has no input {self._register} ({types or 'no type'})"
                return b""
            self._recipe = payload[0]
            return rtde.package(rtde.OUTPUTS, struct.pack(">d", 1.0) + b"timestamp")
        if kind == rtde.OUTPUTS:
            return rtde.package(rtde.START)
        if kind == rtde.START:
            self.running = payload == b"\x01"
            if not self.running:
                self.unsupported = "it refuses to start"
        return b""

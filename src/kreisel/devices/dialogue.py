"""What a dialogue over one connection is: bytes in, readings and answers out. No sockets here."""

from __future__ import annotations

from dataclasses import dataclass

from kreisel.devices.events import Level
from kreisel.errors import ProtocolError
from kreisel.protocols.samples import ImuSample, RobotSample


@dataclass(frozen=True)
class Remark:
    """Something to report each time that it is found; faults are reported at most once a second."""

    text: str
    level: Level = Level.INFO


Found = ImuSample | RobotSample | ProtocolError | Remark
"""What there is in the bytes of a device."""


class Losses:
    """Reports of lost bytes and frames of a protocol, by a decoder's counts; each loss is reported once.

    Parameters
    ----------
    protocol
        Its name.
    """

    def __init__(self, protocol: str) -> None:
        self._protocol = protocol
        self._skipped = self._missing = 0

    def since(self, skipped: int, missing: int) -> list[Found]:
        """Return the errors about what has been lost since the last call."""
        counts = ((skipped - self._skipped, "bytes belong to no frame"), (missing - self._missing, "frames were lost"))
        self._skipped, self._missing = skipped, missing
        return [ProtocolError(self._protocol, f"{count} {text}") for count, text in counts if count > 0]


class Session:
    """The state of one connection to a device; every connection gets a new one.

    Attributes
    ----------
    period
        Seconds between two requests, if a device sends only what is requested; otherwise None.
    silence
        What to say when no reading is received.
    """

    period: float | None = None
    silence: str = "nothing is received; is the robot's program running?"

    def begin(self) -> bytes:
        """Return what to send first."""
        return b""

    def ask(self, now_ns: int) -> bytes:
        """Return the next request; `now_ns` is on the host's clock."""
        raise NotImplementedError(f"{type(self).__name__} at {now_ns} sends no requests")

    def receive(self, data: bytes, now_ns: int) -> tuple[list[Found], bytes]:
        """Return the readings and errors in bytes received at `now_ns`, and what to send.

        Raises
        ------
        ProtocolError
            If the connection is no longer usable.
        """
        raise NotImplementedError(f"{type(self).__name__} reads nothing of {len(data)} bytes at {now_ns}")

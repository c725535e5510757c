"""A simulated autopilot: it shows itself to a port, and sends the readings of its IMU once it is asked for them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from kreisel.devices.simulators import Pace, play
from kreisel.protocols import mavlink
from kreisel.protocols.samples import ImuSample

_BEAT = 0.2  # s between two signs of life; chosen shorter than a real autopilot's second, so that nobody waits


class Autopilot:
    """What an autopilot answers, and the frames of its readings.

    Parameters
    ----------
    on_client
        Called when readings are requested for the first time.
    kind
        Number of the autopilot's software, as in `mavlink.ARDUPILOT`.
    """

    def __init__(self, on_client: Callable[[], None] = lambda: None, kind: int = 12) -> None:
        self._on_client, self._kind = on_client, kind
        self._decoder = mavlink.Decoder()
        self._sequence = 0
        self.streaming = False

    def receive(self, data: bytes, stamp_ns: int) -> bytes:
        """Return the answers to bytes received at a time of the autopilot's clock."""
        answer = b""
        for frame in self._decoder.receive(data):
            if mavlink.asks_time(frame):
                answer += mavlink.answer_time(frame, stamp_ns, self._next())
            wanted = mavlink.requested(frame)
            if wanted is None:
                continue
            known = wanted[0] == mavlink.Message.HIGHRES_IMU
            answer += mavlink.acknowledge(0 if known else 3, self._next())
            if known and not self.streaming:
                self.streaming = True
                self._on_client()
        return answer

    def beat(self) -> bytes:
        """Return a sign of life."""
        return mavlink.heartbeat(self._next(), autopilot=self._kind)

    def encode(self, sample: ImuSample) -> bytes:
        """Return the frame of a reading, empty if none were requested."""
        return mavlink.encode_sample(sample, self._next()) if self.streaming else b""

    def _next(self) -> int:
        self._sequence += 1
        return self._sequence - 1


class AutopilotSimulator(asyncio.DatagramProtocol):
    """An autopilot that sends to a port, as the simulators of devices that clients connect to; see `TcpSimulator`."""

    def __init__(self, on_client: Callable[[], None] = lambda: None, kind: int = 12) -> None:
        self._autopilot = Autopilot(on_client, kind)
        self._transport: Any = None
        self._beating: asyncio.Task[None] | None = None
        self._stamp_ns, self._sent_ns = 0, time.monotonic_ns()

    async def serve(self, host: str, port: int) -> int:
        """Begin to show itself at a port, and return the port."""
        loop = asyncio.get_running_loop()
        await loop.create_datagram_endpoint(lambda: self, remote_addr=(host, port))
        self._beating = asyncio.ensure_future(self._beat())
        return port

    async def play(self, samples: Iterator[ImuSample], pace: Pace) -> None:
        """Send readings at their times, then close."""
        await play(self, samples, pace)

    def send(self, samples: Iterable[ImuSample]) -> None:
        """Send readings."""
        for sample in samples:
            self._stamp_ns, self._sent_ns = sample.stamp_ns, time.monotonic_ns()
            self._write(self._autopilot.encode(sample))

    def close(self) -> None:
        """Fall silent."""
        if self._beating is not None:
            self._beating.cancel()
        if self._transport is not None:
            self._transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport."""
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:  # noqa: ARG002 - connected to one
        """Answer."""
        self._write(self._autopilot.receive(data, self._stamp_ns + time.monotonic_ns() - self._sent_ns))

    def error_received(self, exc: Exception) -> None:
        """Continue: nobody listens yet, or no longer."""

    def _write(self, data: bytes) -> None:
        if data and not self._transport.is_closing():
            self._transport.sendto(data)

    async def _beat(self) -> None:
        while True:
            self._write(self._autopilot.beat())
            await asyncio.sleep(_BEAT)

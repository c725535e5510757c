"""Devices that send datagrams to a port of this machine."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Any

from kreisel.devices.address import Address
from kreisel.devices.datagram_source import Source
from kreisel.devices.dialogue import Found, Session
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.devices.faults import SILENCE, Faults, Silence
from kreisel.devices.sessions import session_at
from kreisel.errors import DeviceError, ProtocolError, SettingsError, unknown_name

_WAITING = 20_000  # datagrams that may wait for a slow consumer
_BUFFER = 1 << 22  # bytes of the system's buffer for datagrams; chosen: two seconds of 8 KiB every 4 ms

Clock = Callable[[], int]


def takes_datagrams(address: Address) -> bool:
    """Return whether the device at an address sends datagrams to a port of this machine."""
    return address.scheme in ("rsi", "egm") or (address.scheme == "mavlink" and not over_tcp(address))


def over_tcp(address: Address) -> bool:
    """Return whether an address asks for a TCP connection in place of datagrams.

    Raises
    ------
    SettingsError
        If it asks for another kind of link.
    """
    link = address.options.get("link", "udp")
    if link not in ("udp", "tcp"):
        raise SettingsError(f"{address}: {unknown_name('link', link, ('udp', 'tcp'))}")
    return link == "tcp"


class _Receiver(asyncio.DatagramProtocol):
    """Gives the datagrams of one sender to a session, and puts what it found into a queue; see `Source`.

    Answers are sent at once: a controller may wait for them no longer than 4 ms.
    """

    def __init__(self, clock: Clock, session: Session, host: str | None = None) -> None:
        self.queue: asyncio.Queue[tuple[list[Found], int]] = asyncio.Queue(_WAITING)
        self.dropped = 0
        self.source = Source(host)
        self._clock, self._session = clock, session
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        now, sender = self._clock(), (str(addr[0]), addr[1])
        if not self.source.takes(sender, now):
            return
        found: list[Found]
        try:
            found, answer = self._session.receive(data, now)
        except ProtocolError as error:
            found, answer = [error], b""
        if sender == self.source.sender or answer or any(not isinstance(item, ProtocolError) for item in found):
            self.source.keep(sender, now)
            if answer:
                self._transport.sendto(answer, addr)
        try:
            self.queue.put_nowait((found, now))
        except asyncio.QueueFull:
            self.dropped += 1

    async def ask(self) -> None:
        """Send the session's requests to the sender, as long as this runs."""
        while self._session.period is not None:
            if self.source.sender is not None:
                self._transport.sendto(self._session.ask(self._clock()), self.source.sender)
            await asyncio.sleep(self._session.period)

    def error_received(self, exc: Exception) -> None:
        """Continue: an answer did not reach the device, which reports that itself."""


async def datagrams(address: Address, clock: Clock = time.monotonic_ns) -> AsyncIterator[Event]:
    """Yield the events of a device that sends to a port of this machine.

    Raises
    ------
    DeviceError
        If the port cannot be opened, or the host that may send is not known.
    """
    session = session_at(address)
    host = await _resolved(address)
    transport, receiver = await _listen(address, lambda: _Receiver(clock, session, host))
    asking = asyncio.ensure_future(receiver.ask())
    faults, reports, silence = Faults(), _Reports(address, receiver), Silence(address, clock())
    try:
        while True:
            found, now = await _next(receiver.queue) or ([], clock())
            for notice in reports.take(now) + silence.look(now, lambda: session.silence):
                yield notice  # what is received may not be telegrams
            for event in faults.events(found, now, address):
                for notice in silence.hear(now) if isinstance(event, Arrival) else ():
                    yield notice
                yield event
    finally:
        transport.close()
        asking.cancel()


async def _resolved(address: Address) -> str | None:
    """Return the IP address of the only host that may send, None where none is stated.

    Raises
    ------
    DeviceError
        If its name is not known.
    """
    name = address.options.get("from")
    if name is None:
        return None
    try:
        found = await asyncio.get_running_loop().getaddrinfo(name, None, family=socket.AF_INET)
    except OSError as error:
        raise DeviceError(f"{address}: the host '{name}' is not known ({error.strerror or error})") from error
    return str(found[0][4][0])


async def _listen(address: Address, receiver: Callable[[], _Receiver]) -> tuple[asyncio.DatagramTransport, _Receiver]:
    """Return a port of this machine that is open for datagrams, and its receiver."""
    try:
        transport, made = await asyncio.get_running_loop().create_datagram_endpoint(
            receiver, local_addr=(address.host, address.port)
        )
    except OSError as error:
        raise DeviceError(
            f"{address}: cannot listen there ({error.strerror or error}): does another program listen there, or is it "
            "not an address of this machine?"
        ) from error
    with suppress(OSError):
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    return transport, made


async def _next(queue: asyncio.Queue[tuple[list[Found], int]]) -> tuple[list[Found], int] | None:
    """Return what was found in the next datagram, or None if none is received for `SILENCE` seconds."""
    try:
        async with asyncio.timeout(SILENCE):
            return await queue.get()
    except TimeoutError:
        return None


class _Reports:
    """What to report about a port besides its readings: other senders, dropped datagrams."""

    def __init__(self, address: Address, receiver: _Receiver) -> None:
        self._address, self._receiver = address, receiver
        self._dropped = 0
        self._locked_out = False

    def take(self, now: int) -> list[Notice]:
        """Return notices about what happened since the last call."""
        texts = self._receiver.source.news()
        if self._receiver.dropped > self._dropped:
            texts.append(f"{self._receiver.dropped - self._dropped} messages dropped here")
            self._dropped = self._receiver.dropped
        notices = [Notice(Level.WARNING, f"{self._address}: {text}", now) for text in texts]
        if self._receiver.source.locked_out and not self._locked_out:
            self._locked_out = True
            text = "another sender was turned away: which of them is the device? State its host as ?from=HOST"
            notices.append(Notice(Level.LOCKED_OUT, f"{self._address}: {text}", now))
        return notices

"""Drivers: each yields the events of the device at an address, without end, and connects again after every loss.

A driver does not end by itself, unless it plays a recording, and it does not raise because of what a device does. It
reads; it sends only what makes a device stream, and nothing that moves a robot.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from kreisel.devices.address import Address
from kreisel.devices.datagrams import Clock, datagrams, takes_datagrams
from kreisel.devices.dialogue import Session
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.devices.faults import AGAIN, SILENCE, Faults
from kreisel.devices.sessions import session_at
from kreisel.errors import ProtocolError, SettingsError

RETRY = 0.5
"""Seconds between attempts to connect."""

_PATIENCE = 5.0
"""s for one attempt to connect. Chosen: a lost packet is sent again after one second, and after two more; the system's
own limit is minutes, and a device that was switched on meanwhile would wait as long."""

_CHUNK = 65536  # bytes read at once; the buffer of asyncio's StreamReader by default


def device_events(address: Address, clock: Clock = time.monotonic_ns) -> AsyncIterator[Event]:
    """Return the events of the device at an address.

    Raises
    ------
    SettingsError, ProtocolError
        If an option of the address is invalid.
    """
    session_at(address)  # so that a wrong option raises at once
    if takes_datagrams(address):
        return datagrams(address, clock)
    return _stream(address, clock)


async def _stream(address: Address, clock: Clock) -> AsyncIterator[Event]:
    """Yield the events of a connection; connect again whenever it is lost."""
    faults, lost_ns = Faults(), None
    while True:
        try:
            async with asyncio.timeout(_PATIENCE):
                reader, writer = await connect(address)
        except (OSError, TimeoutError) as error:
            if lost_ns is None:
                lost_ns = clock()
                yield Notice(Level.LOST, f"{address}: cannot be reached ({_why(error)}){AGAIN}", lost_ns)
            await asyncio.sleep(RETRY)
            continue
        why = ProtocolError("connection", "closed by the device")
        try:
            async for event in _converse(address, reader, writer, clock, faults):
                if lost_ns is not None and isinstance(event, Arrival):
                    gap = (event.host_ns - lost_ns) * 1e-9
                    yield Notice(Level.INFO, f"{address}: readings are received again after {gap:.1f} s", event.host_ns)
                    lost_ns = None
                yield event
        except TimeoutError:
            why = ProtocolError("connection", f"silent for {SILENCE:g} s")
        except OSError as error:
            why = ProtocolError("connection", _why(error))
        except ProtocolError as error:
            why = error
        finally:
            writer.close()
        if lost_ns is None:
            lost_ns = clock()
            yield Notice(Level.LOST, f"{address}: lost ({why}); trying to connect again", lost_ns)
        await asyncio.sleep(RETRY)


async def _converse(
    address: Address, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, clock: Clock, faults: Faults
) -> AsyncIterator[Event]:
    """Yield the events of one connection, until it ends."""
    session = session_at(address)
    writer.write(session.begin())
    asking = None if session.period is None else asyncio.ensure_future(_ask(session, writer, clock))
    try:
        while True:
            async with asyncio.timeout(SILENCE):
                data = await reader.read(_CHUNK)
            now = clock()
            if not data:
                return
            found, answer = session.receive(data, now)
            writer.write(answer)
            for event in faults.events(found, now, address):
                yield event
    finally:
        if asking is not None:
            asking.cancel()


async def _ask(session: Session, writer: asyncio.StreamWriter, clock: Clock) -> None:
    while session.period is not None:
        writer.write(session.ask(clock()))
        await asyncio.sleep(session.period)


async def connect(address: Address) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Return the streams of a new connection, or of a serial line.

    Raises
    ------
    OSError
        If the connection cannot be opened.
    SettingsError
        If a serial line's option is invalid, or pyserial is not installed.
    """
    if address.scheme != "serial":
        return await asyncio.open_connection(address.host, address.port)
    try:
        import serial  # here, because it is an optional dependency
    except ImportError as error:
        raise SettingsError("serial lines need pyserial: pip install 'kreisel[live]'") from error
    device = serial.Serial(address.path, int(address.number("baud", 115200, 50, 4e6)), timeout=0)
    loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
    reading, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), device)
    transport, protocol = await loop.connect_write_pipe(asyncio.streams.FlowControlMixin, device)
    writer = _SerialWriter(transport, protocol, reader, loop)
    writer.reading = reading
    return reader, writer


class _SerialWriter(asyncio.StreamWriter):
    """The writing side of a serial line; it closes the reading side too."""

    reading: asyncio.ReadTransport

    def close(self) -> None:
        self.reading.close()
        super().close()


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or f"no answer within {_PATIENCE:g} s"

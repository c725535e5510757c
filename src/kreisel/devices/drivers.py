"""Drivers: each yields the events of the device at an address, without end, and connects again after every loss.

A driver does not end by itself, unless it plays a recording, and it does not raise because of what a device does. It
reads; it sends only what makes a device stream, and nothing that moves a robot.
"""

from __future__ import annotations

import asyncio
import re
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Any

from kreisel.devices.address import Address
from kreisel.devices.datagram_source import Source
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.devices.sessions import SESSIONS, Session
from kreisel.errors import DeviceError, KreiselError, ProtocolError, SettingsError
from kreisel.protocols import egm, rsi
from kreisel.protocols.samples import RobotSample

SILENCE = 1.0
"""Seconds without a message after which a device counts as lost."""

RETRY = 0.5
"""Seconds between attempts to connect."""

_PATIENCE = 5.0
"""s for one attempt to connect. Chosen: a lost packet is sent again after one second, and after two more; the system's
own limit is minutes, and a device that was switched on meanwhile would wait as long."""

_WAITING = 20_000  # datagrams that may wait for a slow consumer
_BUFFER = 1 << 22  # bytes of the system's buffer for datagrams; chosen: two seconds of 8 KiB every 4 ms
_CHUNK = 65536  # bytes read at once; the buffer of asyncio's StreamReader by default

_KINDS = 20
"""Kinds of faults that are counted apart. Chosen: a protocol has fewer; limited, because messages quote what is
sent."""

_PAUSE_NS = 1_000_000_000
"""ns in which a kind of fault is reported once. Chosen: a person can read as much; the number is reported, too."""

Clock = Callable[[], int]


def device_events(address: Address, clock: Clock = time.monotonic_ns) -> AsyncIterator[Event]:
    """Return the events of the device at an address.

    Raises
    ------
    SettingsError, ProtocolError
        If an option of the address is invalid.
    """
    if address.scheme in ("rsi", "egm"):
        return _datagrams(address, clock)
    make: Any = SESSIONS[address.scheme]
    make(address)  # so that a wrong option raises at once
    return _stream(address, clock, lambda: make(address))


class _Faults:
    """Faults of one device; each kind is reported at most once a second, with the number so far."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, int]] = {}

    def report(self, error: KreiselError, now_ns: int) -> list[Notice]:
        kind = re.sub(r"\d+|'.*", "", str(error))[:40]
        if kind not in self._seen and len(self._seen) >= _KINDS:
            kind = "other"
        count, last_ns = self._seen.get(kind, (0, -_PAUSE_NS))
        quiet = now_ns - last_ns < _PAUSE_NS
        self._seen[kind] = (count + 1, last_ns if quiet else now_ns)
        if quiet:
            return []
        more = "" if count == 0 else f" ({count + 1} such messages so far)"
        return [Notice(Level.WARNING, f"{error}{more}", now_ns)]


Decode = Callable[[bytes], RobotSample]


class _Receiver(asyncio.DatagramProtocol):
    """Puts the datagrams of one sender into a queue, with their times of arrival; see `Source`."""

    def __init__(self, clock: Clock, decode: Decode, *, answers: bool, host: str | None = None) -> None:
        self.queue: asyncio.Queue[tuple[bytes, int]] = asyncio.Queue(_WAITING)
        self.dropped = 0
        self.source = Source(host)
        self._clock, self._decode, self._answers = clock, decode, answers
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        now, sender = self._clock(), (str(addr[0]), addr[1])
        if not self.source.takes(sender, now):
            return
        if sender == self.source.sender or self._is_telegram(data):
            self.source.keep(sender, now)
            if self._answers:
                with suppress(ProtocolError):
                    self._transport.sendto(rsi.encode_answer(data), addr)
        try:
            self.queue.put_nowait((data, now))
        except asyncio.QueueFull:
            self.dropped += 1

    def _is_telegram(self, data: bytes) -> bool:
        try:
            self._decode(data)
        except ProtocolError:
            return False
        return True

    def error_received(self, exc: Exception) -> None:
        """Continue: an answer did not reach the controller, which reports that itself."""


async def _datagrams(address: Address, clock: Clock) -> AsyncIterator[Event]:
    """Yield what a controller sends to a port of this machine."""
    decode: Decode = {"rsi": rsi.decode, "egm": egm.decode}[address.scheme]
    answers = address.options.get("answer", "no").lower() in ("yes", "true", "1")
    host = await _resolved(address)
    transport, receiver = await _listen(address, lambda: _Receiver(clock, decode, answers=answers, host=host))
    faults, reports, silent, heard = _Faults(), _Reports(address, receiver), False, clock()
    try:
        while True:
            item = await _next(receiver.queue)
            now = clock() if item is None else item[1]
            for notice in reports.take(b"" if item is None or not answers else item[0], now):
                yield notice
            if not silent and now - heard > SILENCE * 1e9:  # what is received may not be telegrams
                silent = True
                yield Notice(Level.LOST, f"{address}: nothing is received; is the robot's program running?", now)
            if item is None:
                continue
            try:
                sample = decode(item[0])
            except ProtocolError as error:
                for notice in faults.report(error, now):
                    yield notice
                continue
            heard = now
            if silent:
                silent = False
                yield Notice(Level.INFO, f"{address}: messages are received again", now)
            yield Arrival(sample, now)
    finally:
        transport.close()


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


async def _next(queue: asyncio.Queue[tuple[bytes, int]]) -> tuple[bytes, int] | None:
    """Return the next datagram, or None if nothing is received for `SILENCE` seconds."""
    try:
        async with asyncio.timeout(SILENCE):
            return await queue.get()
    except TimeoutError:
        return None


class _Reports:
    """What to report about a port besides its samples: other senders, dropped datagrams, late answers."""

    def __init__(self, address: Address, receiver: _Receiver) -> None:
        self._address, self._receiver = address, receiver
        self._dropped = self._late = 0
        self._locked_out = False

    def take(self, data: bytes, now: int) -> list[Notice]:
        """Return notices; `data` is the datagram that was to be answered, empty if there is none."""
        texts = self._receiver.source.news()
        if self._receiver.dropped > self._dropped:
            texts.append(f"{self._receiver.dropped - self._dropped} messages dropped here")
            self._dropped = self._receiver.dropped
        missed = rsi.late_answers(data)
        if missed > self._late:
            texts.append(
                f"{missed - self._late} answers reached the controller late, {missed} in all; it stops the robot after "
                "a few: is this machine busy?"
            )
        self._late = missed if data else self._late
        notices = [Notice(Level.WARNING, f"{self._address}: {text}", now) for text in texts]
        if self._receiver.source.locked_out and not self._locked_out:
            self._locked_out = True
            text = "another sender was turned away: which of them is the robot? State its host as ?from=HOST"
            notices.append(Notice(Level.LOCKED_OUT, f"{self._address}: {text}", now))
        return notices


async def _stream(address: Address, clock: Clock, session: Callable[[], Session]) -> AsyncIterator[Event]:
    """Yield the events of a connection; connect again whenever it is lost."""
    faults, lost_ns = _Faults(), None
    while True:
        try:
            async with asyncio.timeout(_PATIENCE):
                reader, writer = await connect(address)
        except (OSError, TimeoutError) as error:
            if lost_ns is None:
                lost_ns = clock()
                yield Notice(Level.LOST, f"{address}: cannot be reached ({_why(error)}); trying again", lost_ns)
            await asyncio.sleep(RETRY)
            continue
        why = ProtocolError("connection", "closed by the device")
        try:
            async for event in _converse(session(), reader, writer, clock, faults):
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
    session: Session, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, clock: Clock, faults: _Faults
) -> AsyncIterator[Event]:
    """Yield the events of one connection, until it ends."""
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
            for item in found:
                if isinstance(item, ProtocolError):
                    for notice in faults.report(item, now):
                        yield notice
                else:
                    yield Arrival(item, now)
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

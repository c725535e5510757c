"""Simulated controllers and IMUs: they send a recording over the network, with the bytes of the real devices."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Protocol

from kreisel.errors import ProtocolError
from kreisel.protocols import egm, ekrl, ixcom, line, rsi, rtde, varproxy
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.recording.recording import ImuSamples, Recording

_ROWS = 1000
"""Readings that are converted at once. Chosen: seconds of an IMU, so that the first of a long recording comes at once,
and conversion of whole arrays is still fast."""

SHARED = 3.0
"""Factor on the time in which a simulated controller expects a heartbeat. Chosen: it shares a machine with its peer,
and either waits for the other where that is busy (heartbeats of 0.1 s came 0.16 s apart beside three processes)."""

_TICK = 0.01  # s between two looks at the arm
_LATE = 0.05
"""s from which this process was late itself, and not its peer. Chosen: five times `_TICK`."""


def imu_samples(imu: ImuSamples) -> Iterator[ImuSample]:
    """Yield the readings of a recording one by one; they are converted in parts, so that the first comes at once."""
    for begin in range(0, imu.stamps_ns.size, _ROWS):
        part = slice(begin, begin + _ROWS)
        rows = zip(
            imu.stamps_ns[part].tolist(), imu.rates[part].tolist(), imu.accelerations[part].tolist(), strict=True
        )
        for stamp, rate, acceleration in rows:
            yield ImuSample(stamp, tuple(rate), tuple(acceleration))


def robot_samples(recording: Recording) -> Iterator[RobotSample]:
    """Yield the poses of a recording one by one, with joint angles if it has them."""
    reference, joints = recording.reference, recording.joints
    if reference is None:
        return
    for k, stamp in enumerate(reference.stamps_ns.tolist()):
        yield RobotSample(
            stamp,
            None if reference.positions is None else tuple(reference.positions[k].tolist()),
            None if reference.quaternions is None else tuple(reference.quaternions[k].tolist()),
            () if joints is None else tuple(joints.angles[k].tolist()),
        )


class Pace:
    """Real time, or a multiple of it, from a start time that all simulators of a cell share.

    Parameters
    ----------
    began
        Returns the start time, s of the system's monotonic clock, or None before it is known.
    speed
        How many seconds pass on the devices' clocks in one second of real time.
    """

    def __init__(self, began: Callable[[], float | None], speed: float = 1.0) -> None:
        self._began, self._speed = began, speed

    async def until(self, seconds: float) -> None:
        """Wait until so many seconds of a device's clock have passed."""
        while (began := self._began()) is None:
            await asyncio.sleep(0.005)
        wait = began + seconds / self._speed - time.monotonic()
        if wait > 0.0:
            await asyncio.sleep(wait)


class Datagrams:
    """A controller that sends its poses to a port, as RSI and EGM do; answers are ignored."""

    def __init__(self, scheme: str, host: str, port: int) -> None:
        self._scheme, self._where, self._number = scheme, (host, port), 0
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> int:
        """Open the socket, and return the port."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, remote_addr=self._where)
        return self._where[1]

    def send(self, samples: Iterable[RobotSample]) -> None:
        """Send poses."""
        for sample in samples:
            data = rsi.encode(sample) if self._scheme == "rsi" else egm.encode(sample, self._number)
            self._number += 1
            if self._transport is not None:
                self._transport.sendto(data)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()


class Sender(Protocol):
    """A simulated device that sends samples."""

    def send(self, samples: Iterable[Any]) -> None:
        """Send samples."""

    def close(self) -> None:
        """Send no more."""


async def play(device: Sender, samples: Iterator[ImuSample] | Iterator[RobotSample], pace: Pace) -> None:
    """Send samples at their times, then close."""
    first_ns: int | None = None
    for sample in samples:
        first_ns = sample.stamp_ns if first_ns is None else first_ns
        await pace.until((sample.stamp_ns - first_ns) * 1e-9)
        device.send([sample])
    device.close()


async def play_datagrams(scheme: str, samples: Iterator[RobotSample], host: str, port: int, pace: Pace) -> None:
    """Send poses to a port, as an RSI or EGM controller does."""
    sender = Datagrams(scheme, host, port)
    await sender.open()
    try:
        await play(sender, samples, pace)
    finally:
        sender.close()


class Commanded(Protocol):
    """An arm that takes moves."""

    def move(self, target: Sequence[float]) -> str | None:
        """Begin a move, or return why it is refused."""

    def stop(self) -> None:
        """Stop the arm where it is."""

    @property
    def moving(self) -> bool:
        """Whether a move is under way."""


async def ekrl_simulator(arm: Commanded, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Execute and answer telegrams until the connection ends, as kreisel's program on a KUKA controller does."""
    splitter, no_pose = ekrl.Splitter("Kreisel"), RobotSample(0, None, None, (0.0,) * 6)

    def answer(number: int, doing: ekrl.Doing) -> None:
        writer.write(ekrl.encode_state(ekrl.State(number, doing, no_pose)))

    arrives: asyncio.Task[None] | None = None
    heard = time.monotonic()

    async def arrive(number: int) -> None:
        nonlocal heard
        while arm.moving:
            before = time.monotonic()
            await asyncio.sleep(_TICK)
            if time.monotonic() - before > _LATE:  # this process was late: what it was sent meanwhile comes first
                heard = time.monotonic()
            if time.monotonic() - heard > SHARED * ekrl.BEAT_PATIENCE:
                arm.stop()
                answer(number, ekrl.Doing.STOPPED)
                return
        answer(number, ekrl.Doing.ARRIVED)

    try:
        while data := await reader.read(4096):
            for telegram in splitter.receive(data):
                try:
                    command = ekrl.decode(telegram)
                except ProtocolError:
                    continue
                if isinstance(command, ekrl.Beat):
                    heard = time.monotonic()
                elif isinstance(command, ekrl.Stop):
                    arm.stop()
                    answer(command.number, ekrl.Doing.STOPPED)
                elif arm.move(command.target) is None:
                    heard = time.monotonic()
                    answer(command.number, ekrl.Doing.MOVING)
                    arrives = asyncio.ensure_future(arrive(command.number))
                else:
                    answer(command.number, ekrl.Doing.REFUSED)
    finally:
        if arrives is not None:
            arrives.cancel()


class _Clients:
    """The clients a stream is sent to; one that does not read is disconnected."""

    _MAX_COMMAND = 1 << 20

    def __init__(self) -> None:
        self._writers: dict[asyncio.StreamWriter, Callable[[object], bytes]] = {}

    def add(self, writer: asyncio.StreamWriter, encode: Callable[[object], bytes]) -> None:
        self._writers[writer] = encode

    def remove(self, writer: asyncio.StreamWriter) -> None:
        self._writers.pop(writer, None)

    def send(self, sample: object) -> None:
        for writer, encode in list(self._writers.items()):
            if writer.is_closing() or writer.transport.get_write_buffer_size() > self._MAX_COMMAND:
                self.remove(writer)
                writer.close()
            else:
                writer.write(encode(sample))

    def close(self) -> None:
        for writer in self._writers:
            writer.close()


class TcpSimulator:
    """A device that clients connect to: call `serve`, then `play` or `send`.

    Parameters
    ----------
    scheme
        `rtde`, `ekrl` (states only), `varproxy`, `ixcom` or `csv`.
    on_client
        Called when the first client wants data.
    on_write
        Called when a client has written inputs (`rtde`).
    """

    def __init__(
        self, scheme: str, on_client: Callable[[], None] = lambda: None, on_write: Callable[[], None] = lambda: None
    ) -> None:
        self._clients = _Clients()
        self._on_client, self._on_write = on_client, on_write
        self._latest: object = None
        self._talk = {
            "rtde": self._rtde,
            "ekrl": self._ekrl,
            "varproxy": self._varproxy,
            "ixcom": self._ixcom,
            "csv": self._lines,
        }[scheme]
        self._server: asyncio.Server | None = None

    async def serve(self, host: str, port: int) -> int:
        """Listen, and return the port."""
        self._server = await asyncio.start_server(self._connected, host, port)
        return int(self._server.sockets[0].getsockname()[1])

    async def play(self, samples: Iterator[ImuSample] | Iterator[RobotSample], pace: Pace) -> None:
        """Send samples to all clients at their times, then close."""
        await play(self, samples, pace)

    def close(self) -> None:
        """Disconnect all clients, and stop listening."""
        self._clients.close()
        if self._server is not None:
            self._server.close()

    def send(self, samples: Iterable[ImuSample | RobotSample]) -> None:
        """Send samples to all clients."""
        for sample in samples:
            self._latest = sample
            self._clients.send(sample)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError, ProtocolError, asyncio.CancelledError):  # CancelledError: the cell ends
                await self._talk(reader, writer)
        finally:
            self._clients.remove(writer)
            writer.close()

    def _begin(self, writer: asyncio.StreamWriter, encode: Callable[[object], bytes]) -> None:
        self._clients.add(writer, encode)
        self._on_client()

    async def _rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        server = rtde.Server()
        while data := await reader.read(4096):
            written = server.written
            writer.write(server.receive(data))
            if server.written > written:
                self._on_write()
            elif server.streaming:
                self._begin(writer, server.encode)  # type: ignore[arg-type]
            else:
                self._clients.remove(writer)

    async def _ekrl(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        def encode(sample: object) -> bytes:
            if not isinstance(sample, RobotSample):
                return b""
            return ekrl.encode_state(ekrl.State(0, ekrl.Doing.ARRIVED, sample))

        self._begin(writer, encode)
        while await reader.read(4096):
            pass

    async def _varproxy(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        splitter = varproxy.splitter()
        while data := await reader.read(4096):
            for number, content in splitter.receive(data):
                name, latest = varproxy.decode_request(number, content).name, self._latest
                value = varproxy.variable(name, latest) if isinstance(latest, RobotSample) else None
                writer.write(varproxy.encode_answer(varproxy.Answer(number, value or "", value is not None)))

    async def _ixcom(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        decoder, count, sent = ixcom.Decoder(), 0, 0

        def encode(sample: object) -> bytes:
            nonlocal count, sent
            count += 1
            if not isinstance(sample, ImuSample) or count % divider:
                return b""
            sent += 1
            return ixcom.encode_sample(sample, sent - 1)

        while data := await reader.read(4096):
            for frame in decoder.receive(data):
                writer.write(ixcom.respond(0, "OK", frame.counter))
                wanted = ixcom.wanted_log(frame)
                if wanted is not None and wanted[0] == ixcom.IMURAW:
                    divider = wanted[1]
                    self._begin(writer, encode)

    async def _lines(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(f"#{line.COLUMNS}\n".encode())
        self._begin(writer, line.encode)  # type: ignore[arg-type]
        while await reader.read(4096):
            pass

"""Movers: they send moves to a controller, as URScript or as telegrams to kreisel's program on a KUKA controller."""

from __future__ import annotations

import asyncio
import itertools
from contextlib import suppress
from typing import Protocol

import numpy as np

from kreisel.acquisition.background import cancel
from kreisel.acquisition.heartbeat import DeadMansSwitch
from kreisel.acquisition.stopping import Way
from kreisel.devices.address import Address
from kreisel.devices.drivers import connect
from kreisel.errors import DeviceError, ProtocolError
from kreisel.geometry.rotation import Array
from kreisel.protocols import ekrl, secondary, urscript

_PATIENCE = 3.0
"""s to wait for a connection, and for the answer to a move. Chosen: in a local network answers come within
milliseconds, from a KRL program within some cycles; the arm stands still meanwhile."""

_QUICK = 1.0
"""Longest time for one way to stop, s."""

_DASHBOARD = 29999  # TCP port of Universal Robots' dashboard server, by the maker's description of it
_CHUNK = 4096  # bytes read at once; chosen: a TCP segment is smaller, and splitters take pieces of any size


def mover_at(address: Address, speed: float, fastest: float) -> Mover:
    """Return the mover for an address with a scheme of `devices.address.MOVERS`.

    Parameters
    ----------
    speed
        The leading joint's speed at full share, rad/s.
    fastest
        The fastest joint's maximum speed, rad/s; speeds in telegrams are shares of it.
    """
    if address.scheme == "urscript":
        return UrScriptMover(address, speed)
    return EkrlMover(address, min(1.0, speed / fastest) if fastest > 0.0 else 1.0, speed)


class Mover(Protocol):
    """Sends moves to a controller.

    Attributes
    ----------
    full_speed
        Speed of the leading joint at full share, rad/s.
    straight
        Whether moves are straight in joint angles.
    """

    full_speed: float
    straight: bool

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached.
        """

    @property
    def trouble(self) -> str | None:
        """The reason why no more moves can be sent, such as a lost connection; None if there is none."""

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways to stop, the quickest first."""

    async def move(self, target: Array, speed: float) -> None:
        """Send one move."""

    async def close(self) -> None:
        """Close the connection."""

    @property
    def guard(self) -> str:
        """What stops the arm when this program no longer runs, or that nothing does; known once connected."""

    @property
    def excuse(self) -> str:
        """Why the controller may have ended a move that nobody stopped; empty if nothing is known."""

    def describe(self, target: Array, speed: float) -> str:
        """Return the text of the command for a move."""

    def peaks(self, way: Array, speed: float, limits: Array) -> tuple[Array, Array | None]:
        """Return the joints' largest velocities (rad/s) and accelerations (rad/s^2) in a move by `way`, (n,) rad.

        Accelerations are None if the controller uses a share of its own limits. `limits` are the model's, rad/s.
        """


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def _reach(address: Address, advice: str) -> Streams:
    """Return the streams of a new connection."""
    try:
        async with asyncio.timeout(_PATIENCE):
            return await connect(address)
    except (OSError, TimeoutError) as error:
        why = getattr(error, "strerror", None) or "no answer"
        raise DeviceError(f"{address}: the controller does not accept commands ({why}); {advice}") from error


class _Line:
    """A connection to a script port; the controller's data are read continuously, so that its end is detected.

    Attributes
    ----------
    ended
        How the connection ended, or None.
    blocked
        The state reported on this connection in which the arm must not move; empty if none is reported.
    """

    def __init__(self, streams: Streams) -> None:
        self.ended: str | None = None
        self.blocked = ""
        self._reader, self._writer = streams
        self._reading = asyncio.ensure_future(self._read())

    async def send(self, data: bytes) -> None:
        """Send bytes; raise DeviceError if the connection has ended."""
        try:
            if self.ended is None:
                self._writer.write(data)
                await self._writer.drain()
        except OSError as error:
            self.ended = self.ended or error.strerror or str(error)
        if self.ended is not None:
            raise DeviceError(f"the script connection has ended ({self.ended})")

    async def close(self) -> None:
        await cancel(self._reading)
        self._writer.close()

    async def _read(self) -> None:
        client = secondary.Client()
        try:
            while data := await self._reader.read(_CHUNK):
                self.blocked = client.receive(data) or self.blocked
            self.ended = self.ended or "closed by the controller"
        except OSError as error:
            self.ended = self.ended or error.strerror or str(error)


class UrScriptMover:
    """Sends moves to a Universal Robots controller as lines of URScript over its secondary interface.

    Parameters
    ----------
    speed
        The leading joint's speed at full share, rad/s.
    """

    straight = True

    def __init__(self, address: Address, speed: float) -> None:
        self.full_speed = speed
        self._address = address
        self._lines: list[_Line] = []
        self._switch = DeadMansSwitch(address)
        self._dashboard = int(address.number("dashboard", _DASHBOARD, 1, 65535))

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached, or another program writes the watchdog's register.
        """
        self._lines.append(_Line(await _reach(self._address, "is remote control switched on?")))
        await self._switch.connect()

    @property
    def guard(self) -> str:
        """What stops the arm when this program no longer runs, or that nothing does."""
        dog = self._switch.planned
        if not self._switch.missing:
            return (
                f"the controller stops the arm by itself when {dog.register} is not written for {1.0 / dog.least:g} s: "
                "after a crash, a computer that hangs, or a cable that is cut"
            )
        return (
            f"NOTHING STOPS THE ARM IF THIS COMPUTER FAILS: the controller has no watchdog over RTDE "
            f"({self._switch.missing}); stay at the emergency stop"
        )

    @property
    def trouble(self) -> str | None:
        """The reason why no more moves can be sent, or None."""
        for line in self._lines[:1]:
            if line.blocked:
                return f"the controller reports: {line.blocked}"
            if line.ended is not None:
                return f"{self._address}: the script connection has ended ({line.ended})"
        return self._switch.trouble

    @property
    def excuse(self) -> str:
        """Why the controller may have ended a move that nobody stopped; empty if nothing is known."""
        if self._switch.watchdog is None or self._switch.slowest < 1.0 / self._switch.watchdog.least:
            return ""
        return f"its watchdog did so, for a heartbeat was {self._switch.slowest:.2f} s late: this computer is too busy"

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways to stop, the quickest first."""
        return (
            ("stopj over the script connection", self.stop),
            ("stopj over a new script connection", self._stop_anew),
            (f"'stop' to the dashboard server at port {self._dashboard}", self._stop_at_dashboard),
            *((("no more heartbeats for the watchdog", self._switch.cease),) if self._switch.watchdog else ()),
        )

    async def move(self, target: Array, speed: float) -> None:
        """Send one move."""
        if not self._lines:
            raise DeviceError(f"{self._address}: not connected")
        try:
            await self._lines[0].send(urscript.encode(self._command(target, speed), self._switch.watchdog))
        except DeviceError as error:
            raise DeviceError(f"{self._address}: {error}") from error

    async def stop(self) -> None:
        """Stop the arm where it is, over the connection of the moves."""
        if not self._lines:
            raise DeviceError("not connected")
        await self._lines[0].send(urscript.encode(urscript.Stop()))

    async def _stop_anew(self) -> None:
        """Send a new program over a new connection; it replaces the running one."""
        try:
            async with asyncio.timeout(_QUICK):
                line = _Line(await connect(self._address))
        except (OSError, TimeoutError) as error:
            raise DeviceError(getattr(error, "strerror", None) or "no answer") from error
        self._lines.append(line)
        await line.send(urscript.encode(urscript.Stop()))

    async def _stop_at_dashboard(self) -> None:
        try:
            async with asyncio.timeout(_QUICK):
                reader, writer = await asyncio.open_connection(self._address.host, self._dashboard)
        except (OSError, TimeoutError) as error:
            raise DeviceError(getattr(error, "strerror", None) or "no answer") from error
        answer = b""
        try:
            writer.write(b"stop\n")
            await writer.drain()
            with suppress(TimeoutError, ValueError):  # without an answer, the program may have stopped anyway
                async with asyncio.timeout(_QUICK):
                    while (answer := await reader.readline()).startswith(b"Connected"):  # the greeting
                        pass
        except OSError as error:
            raise DeviceError(error.strerror or str(error)) from error
        finally:
            writer.close()
        if b"fail" in answer.lower() or b"could not" in answer.lower():
            raise DeviceError(f"the answer is '{answer[:60].decode('ascii', 'replace').strip()}'")

    async def close(self) -> None:
        """Close the connections."""
        await self._switch.close()
        for line in self._lines:
            await line.close()

    def describe(self, target: Array, speed: float) -> str:
        """Return the text of the command for a move."""
        return urscript.encode(self._command(target, speed)).decode().strip()

    def peaks(self, way: Array, speed: float, limits: Array) -> tuple[Array, Array | None]:  # noqa: ARG002
        """Return the joints' largest velocities and accelerations; the values sent are those of the leading joint."""
        share = np.abs(way) / max(float(np.max(np.abs(way))), 1e-9)
        command = self._command(way, speed)
        return share * command.speed, share * command.acceleration

    def _command(self, target: Array, speed: float) -> urscript.JointMove:
        v = speed * self.full_speed
        return urscript.JointMove(tuple(target.tolist()), 2.0 * v, v)


class EkrlMover:
    """Sends moves to kreisel's program on a KUKA controller, over EthernetKRL or a serial line.

    Parameters
    ----------
    share
        Share of the axes' full speed that corresponds to full share in the program.
    speed
        The leading joint's speed at full share, rad/s.
    """

    straight = False

    def __init__(self, address: Address, share: float, speed: float = 1.0) -> None:
        self.full_speed = speed
        self.trouble: str | None = None
        self._address, self._share = address, share
        self._numbers = itertools.count(1)
        self._moving: int | None = None
        self._states: asyncio.Queue[ekrl.State | None] = asyncio.Queue()
        self._streams: Streams | None = None
        self._listening: asyncio.Task[None] | None = None
        self._beating: asyncio.Task[None] | None = None

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached.
        """
        self._streams = await _reach(self._address, "does kreisel's program run there?")
        self._listening = asyncio.ensure_future(self._listen(self._streams[0]))
        if self._address.scheme == "ekrl":
            self._beating = asyncio.ensure_future(self._beat(self._streams[1]))

    async def move(self, target: Array, speed: float) -> None:
        """Send one move, and wait until the controller accepts it.

        Raises
        ------
        DeviceError
            If the move is refused, or not answered.
        """
        number = self._moving = next(self._numbers)
        doing = await self._ask(self._move(target, speed, number), number, _PATIENCE)
        if doing is ekrl.Doing.REFUSED:
            raise DeviceError(
                f"{self._address}: the controller refuses {self.describe(target, speed)}; is it within its limits?"
            )

    @property
    def guard(self) -> str:
        """What stops the arm when this program no longer runs, or that nothing does."""
        if self._address.scheme == "serial":
            return "NOTHING STOPS THE ARM IF THIS COMPUTER FAILS: a serial line hides it; stay at the emergency stop"
        return (
            f"kreisel's program on the controller (of this version) brakes when it gets no heartbeat for "
            f"{ekrl.BEAT_PATIENCE:g} s: after a crash, a computer that hangs, or a cable that is cut"
        )

    @property
    def excuse(self) -> str:
        """Nothing is known: the program tells when it has stopped a move."""
        return ""

    @property
    def ways(self) -> tuple[Way, ...]:
        """Ways to stop, the quickest first; kreisel's program also brakes when the connection is closed."""
        first: Way = ("a Stop telegram", self.stop)
        if self._address.scheme == "serial":
            return (first, ("another Stop telegram", self.stop))
        return (first, ("the connection closed", self.close))

    async def stop(self) -> None:
        """Stop the arm where it is."""
        number, self._moving = next(self._numbers), None
        await self._ask(ekrl.Stop(number), number, _QUICK)

    async def close(self) -> None:
        """Close the connection."""
        await cancel(self._listening, self._beating)
        if self._streams is not None:
            self._streams[1].close()
        self.trouble = self.trouble or "the connection is closed"

    def describe(self, target: Array, speed: float) -> str:
        """Return the text of the command for a move."""
        return ekrl.encode(self._move(target, speed, 0)).decode()

    def peaks(self, way: Array, speed: float, limits: Array) -> tuple[Array, Array | None]:
        """Return the joints' largest velocities; the controller uses the same share of its own accelerations."""
        seconds = float(np.max(np.abs(way) / (speed * self._share * limits)))
        return np.abs(way) / max(seconds, 1e-9), None

    def _move(self, target: Array, speed: float, number: int) -> ekrl.Move:
        return ekrl.Move(number, tuple(target.tolist()), speed * self._share)

    async def _ask(self, command: ekrl.Command, number: int, patience: float) -> ekrl.Doing:
        """Send a command, and return the first state reported for it."""
        if self._streams is None or self._streams[1].is_closing():
            raise DeviceError(f"{self._address}: not connected")
        try:
            self._streams[1].write(ekrl.encode(command))
            await self._streams[1].drain()
            async with asyncio.timeout(patience):
                while (state := await self._states.get()) is not None:
                    if state.number == number:
                        return state.doing
        except TimeoutError:
            raise DeviceError(f"{self._address}: the controller does not answer command {number}") from None
        except OSError as error:
            raise DeviceError(
                f"{self._address}: the connection to the controller is lost ({error.strerror})"
            ) from error
        raise DeviceError(f"{self._address}: the controller has closed the connection")

    async def _beat(self, writer: asyncio.StreamWriter) -> None:
        """Tell the program that this process lives, and its loop turns."""
        try:
            while True:
                writer.write(ekrl.encode(ekrl.Beat()))
                await writer.drain()
                await asyncio.sleep(ekrl.BEAT_INTERVAL)
        except OSError as error:
            self.trouble = self.trouble or f"{self._address}: the heartbeat has ended ({error.strerror or error})"

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        splitter = ekrl.Splitter("Robot")
        try:
            while data := await reader.read(_CHUNK):
                for telegram in splitter.receive(data):
                    try:
                        self._take(ekrl.decode_state(telegram))
                    except ProtocolError:
                        continue  # a later state has the same information
            self.trouble = f"{self._address}: the controller has closed the connection"
        except OSError as error:
            self.trouble = f"{self._address}: the connection has ended ({error.strerror or error})"
        finally:
            self._states.put_nowait(None)

    def _take(self, state: ekrl.State) -> None:
        self._states.put_nowait(state)
        if state.number == self._moving and state.doing is ekrl.Doing.STOPPED:
            self.trouble = f"{self._address}: the controller reports that move {state.number} was stopped"

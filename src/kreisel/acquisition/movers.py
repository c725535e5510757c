"""What sends moves to a controller: lines of URScript, or telegrams to kreisel's program on a KUKA controller."""

from __future__ import annotations

import asyncio
import itertools
from typing import Protocol

from kreisel.devices.address import Address
from kreisel.devices.drivers import connect
from kreisel.errors import DeviceError, ProtocolError
from kreisel.geometry.rotation import Array
from kreisel.protocols import ekrl, urscript

_PATIENCE = 3.0
_CHUNK = 4096


def mover_at(address: Address, speed: float, fastest: float) -> Mover:
    """Return what moves the arm at an address of `devices.address.MOVERS`.

    Parameters
    ----------
    speed
        The leading joint's speed at full share, rad/s.
    fastest
        The slowest joint's largest speed, rad/s: telegrams name shares of it.
    """
    if address.scheme == "urscript":
        return UrScriptMover(address, speed)
    return EkrlMover(address, min(1.0, speed / fastest))


class Mover(Protocol):
    """What sends moves to a controller."""

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached.
        """

    async def move(self, target: Array, speed: float) -> None:
        """Send one move."""

    async def stop(self) -> None:
        """Bring the arm to rest where it is."""

    async def close(self) -> None:
        """Close the connection."""

    def describe(self, target: Array, speed: float) -> str:
        """Return what would be sent."""


Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def _reach(address: Address, advice: str) -> Streams:
    """Return the streams of a new connection."""
    try:
        async with asyncio.timeout(_PATIENCE):
            return await connect(address)
    except (OSError, TimeoutError) as error:
        why = getattr(error, "strerror", None) or "no answer"
        raise DeviceError(f"{address}: the controller takes no commands ({why}); {advice}") from error


class UrScriptMover:
    """Moves for a Universal Robots controller, line by line over its secondary interface.

    Parameters
    ----------
    speed
        The leading joint's speed at full share, rad/s.
    """

    def __init__(self, address: Address, speed: float) -> None:
        self._address, self._speed = address, speed
        self._writer: asyncio.StreamWriter | None = None

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached.
        """
        _, self._writer = await _reach(self._address, "is remote control switched on?")

    async def move(self, target: Array, speed: float) -> None:
        """Send one move."""
        await self._send(urscript.encode(self._command(target, speed)))

    async def stop(self) -> None:
        """Bring the arm to rest where it is."""
        await self._send(urscript.encode(urscript.Stop()))

    async def close(self) -> None:
        """Close the connection."""
        if self._writer is not None:
            self._writer.close()

    def describe(self, target: Array, speed: float) -> str:
        """Return what would be sent."""
        return urscript.encode(self._command(target, speed)).decode().strip()

    def _command(self, target: Array, speed: float) -> urscript.JointMove:
        v = speed * self._speed
        return urscript.JointMove(tuple(target.tolist()), 2.0 * v, v)

    async def _send(self, data: bytes) -> None:
        if self._writer is None:
            raise DeviceError(f"{self._address}: not connected")
        try:
            self._writer.write(data)
            await self._writer.drain()
        except OSError as error:
            raise DeviceError(f"{self._address}: the controller is gone ({error.strerror})") from error


class EkrlMover:
    """Moves for kreisel's program on a KUKA controller, over EthernetKRL or a serial line.

    Parameters
    ----------
    share
        Of the axes' full speed, at full share of the program's.
    """

    def __init__(self, address: Address, share: float) -> None:
        self._address, self._share = address, share
        self._numbers = itertools.count(1)
        self._heard: asyncio.Queue[ekrl.State | None] = asyncio.Queue()
        self._streams: Streams | None = None
        self._listening: asyncio.Task[None] | None = None

    async def connect(self) -> None:
        """Open the connection.

        Raises
        ------
        DeviceError
            If the controller cannot be reached.
        """
        self._streams = await _reach(self._address, "does kreisel's program run there?")
        self._listening = asyncio.ensure_future(self._listen(self._streams[0]))

    async def move(self, target: Array, speed: float) -> None:
        """Send one move, and wait until it is taken up.

        Raises
        ------
        DeviceError
            If it is refused, or nothing is answered.
        """
        number = next(self._numbers)
        doing = await self._ask(self._move(target, speed, number), number)
        if doing is ekrl.Doing.REFUSED:
            raise DeviceError(
                f"{self._address}: the controller refuses {self.describe(target, speed)}; is it within its limits?"
            )

    async def stop(self) -> None:
        """Bring the arm to rest where it is."""
        number = next(self._numbers)
        await self._ask(ekrl.Stop(number), number)

    async def close(self) -> None:
        """Close the connection."""
        if self._listening is not None:
            self._listening.cancel()
            await asyncio.gather(self._listening, return_exceptions=True)
        if self._streams is not None:
            self._streams[1].close()

    def describe(self, target: Array, speed: float) -> str:
        """Return what would be sent."""
        return ekrl.encode(self._move(target, speed, 0)).decode()

    def _move(self, target: Array, speed: float, number: int) -> ekrl.Move:
        return ekrl.Move(number, tuple(target.tolist()), speed * self._share)

    async def _ask(self, command: ekrl.Command, number: int) -> ekrl.Doing:
        """Send a command, and return what is said of it first."""
        if self._streams is None:
            raise DeviceError(f"{self._address}: not connected")
        try:
            self._streams[1].write(ekrl.encode(command))
            await self._streams[1].drain()
            async with asyncio.timeout(_PATIENCE):
                while (state := await self._heard.get()) is not None:
                    if state.number == number:
                        return state.doing
        except TimeoutError:
            raise DeviceError(f"{self._address}: the controller does not answer command {number}") from None
        except OSError as error:
            raise DeviceError(f"{self._address}: the controller is gone ({error.strerror})") from error
        raise DeviceError(f"{self._address}: the controller has closed the connection")

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        splitter = ekrl.Splitter("Robot")
        try:
            while data := await reader.read(_CHUNK):
                for telegram in splitter.receive(data):
                    try:
                        self._heard.put_nowait(ekrl.decode_state(telegram))
                    except ProtocolError:
                        continue  # a later state tells the same
        except OSError:
            pass
        finally:
            self._heard.put_nowait(None)

"""A dead man's switch: a register of the controller that is written while this process lives and its loop turns.

The robot's program watches the register, and the controller stops the program when it is no longer written: after a
crash, a kill, a computer that hangs, or a cable that is cut.
"""

from __future__ import annotations

import asyncio

from kreisel.acquisition.background import cancel
from kreisel.devices.address import Address
from kreisel.errors import DeviceError, ProtocolError
from kreisel.protocols.rtde_heartbeat import RATE, Heartbeat
from kreisel.protocols.urscript import Watchdog

LEAST = 10.0
"""Hz; the controller stops the program when the register is not written for the inverse of it, 0.1 s."""

REGISTER = 24
"""Number of the register by default: the first of those that are for external clients (24 to 47)."""

_PORT = 30004  # TCP port of RTDE, by Universal Robots' description of it
_PATIENCE = 3.0
"""s to wait for the connection and each answer. Chosen: answers come within milliseconds; nothing moves meanwhile."""

_CHUNK = 4096  # bytes read at once; packages are smaller, and splitters take pieces of any size


class DeadMansSwitch:
    """A heartbeat to a Universal Robots controller over a connection of its own.

    Attributes
    ----------
    missing
        Why there is none; empty if there is one.
    trouble
        Why it no longer works; None if it does.
    slowest
        Longest time between two heartbeats, s.
    """

    def __init__(self, address: Address) -> None:
        self.missing = "not connected yet"
        self.trouble: str | None = None
        self.slowest = 0.0
        self._host, self._port = address.host, int(address.number("rtde", _PORT, 1, 65535))
        number = int(address.number("watchdog", REGISTER, 0, 47))
        self._register = f"input_int_register_{number}"
        self._codec = Heartbeat(self._register)
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._beating: asyncio.Task[None] | None = None
        self._reading: asyncio.Task[None] | None = None

    @property
    def planned(self) -> Watchdog:
        """What programs begin with where the controller has such a heartbeat."""
        return Watchdog(self._register, LEAST)

    @property
    def watchdog(self) -> Watchdog | None:
        """What a program must begin with; None where the controller has no such heartbeat."""
        return None if self.missing else self.planned

    async def connect(self) -> None:
        """Begin to write the register, if the controller has it.

        Raises
        ------
        DeviceError
            If another program writes the register.
        """
        try:
            async with asyncio.timeout(_PATIENCE):
                reader, writer = self._streams = await asyncio.open_connection(self._host, self._port)
                writer.write(self._codec.begin())
                while not self._codec.running and not self._codec.unsupported:
                    if not (data := await reader.read(_CHUNK)):
                        break
                    writer.write(self._codec.receive(data))
        except ProtocolError as error:
            raise DeviceError(
                f"{self._host}: {error}, and the watchdog needs a register of its own; give another one, 24 to 47, "
                "as ?watchdog=25 in the robot's address"
            ) from error
        except (OSError, TimeoutError) as error:
            self.missing = (
                f"RTDE at port {self._port} does not answer ({getattr(error, 'strerror', None) or 'silence'})"
            )
            return
        if not self._codec.running:
            self.missing = self._codec.unsupported or "it closes the connection"
            return
        self.missing = ""
        self._beating = asyncio.ensure_future(self._beat(writer))
        self._reading = asyncio.ensure_future(self._read(reader))
        await asyncio.sleep(2.0 / RATE)  # the first must be there before a program watches

    async def cease(self) -> None:
        """Stop writing: the controller then stops the program that watches.

        Raises
        ------
        DeviceError
            If no program watches.
        """
        if self._beating is None:
            raise DeviceError("there is none")
        self._beating.cancel()

    async def close(self) -> None:
        """Close the connection."""
        await cancel(self._beating, self._reading)
        if self._streams is not None:
            self._streams[1].close()

    async def _beat(self, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        last = loop.time()
        try:
            while True:
                writer.write(self._codec.beat())
                await writer.drain()
                self.slowest, last = max(self.slowest, loop.time() - last), loop.time()
                await asyncio.sleep(1.0 / RATE)
        except OSError as error:
            self._ended(error.strerror or str(error))

    async def _read(self, reader: asyncio.StreamReader) -> None:
        """Read and forget what the controller sends, so that the end of the connection is noticed."""
        try:
            while await reader.read(_CHUNK):
                pass
            self._ended("closed by the controller")
        except OSError as error:
            self._ended(error.strerror or str(error))

    def _ended(self, why: str) -> None:
        self.trouble = self.trouble or f"the heartbeat to the controller has ended ({why})"

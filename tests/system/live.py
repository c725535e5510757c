"""What the tests of live recording share: devices on the loopback that do as a test says, and the recorder.

Recordings end after so many readings, or once something was said, not after a time of this machine's clock: on a busy
machine they take longer, and are the same.
"""

import asyncio
import itertools
import re
import socket
import subprocess
import sys
import time
from contextlib import asynccontextmanager, suppress

import numpy as np

from kreisel.acquisition.recorder import record
from kreisel.devices.address import IMUS, ROBOTS, parse_address
from kreisel.devices.events import Arrival
from kreisel.protocols import line
from kreisel.protocols.samples import ImuSample, RobotSample

HOST = "127.0.0.1"
INTERVAL_NS = 2_500_000
CYCLE_NS = 4_000_000
LIMIT = 120.0
"""Seconds after which what is waited for is taken not to come; reached by failures alone."""


def reading(k, start_ns=10**9):
    return ImuSample(start_ns + k * INTERVAL_NS, (0.1, 0.2, 1e-3 * k), (0.0, 0.0, 9.8))


def pose(k, start_ns=5 * 10**9):
    q = (float(np.cos(5e-4 * k)), 0.0, 0.0, float(np.sin(5e-4 * k)))
    return RobotSample(start_ns + k * CYCLE_NS, (1e-3 * k, 0.0, 1.0), q, (1e-3 * k,) * 6)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


async def paced(items, interval):
    """Yield items in real time."""
    began = time.monotonic()
    for k, item in enumerate(items):
        await asyncio.sleep(max(0.0, began + k * interval - time.monotonic()))
        yield item


@asynccontextmanager
async def sending(port, datagrams, interval=CYCLE_NS * 1e-9, host=HOST):
    """Send datagrams to a port while the block runs, from an address of this machine."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, local_addr=(host, 0), remote_addr=(HOST, port)
    )

    async def send():
        async for datagram in paced(datagrams, interval):
            if datagram is not None:
                transport.sendto(datagram)

    task = asyncio.ensure_future(send())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        transport.close()


@asynccontextmanager
async def serving(talk):
    """Serve what is said to every client, and yield the port."""

    clients = {}

    async def quietly(reader, writer):
        with suppress(OSError):
            await talk(reader, writer)
        writer.close()

    def connected(reader, writer):
        clients[writer] = asyncio.ensure_future(quietly(reader, writer))

    server = await asyncio.start_server(connected, HOST, 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer, task in clients.items():
            task.cancel()
            writer.close()
        await asyncio.gather(*clients.values(), *(writer.wait_closed() for writer in clients), return_exceptions=True)


def lines(items, *, header=f"#{line.COLUMNS}"):
    """Return what an IMU of lines says to a client: a header, then items of bytes as they come, None for silence."""

    async def talk(reader, writer):
        writer.write(f"{header}\n".encode())
        async for item in paced(items(), INTERVAL_NS * 1e-9):
            writer.write(item or b"")
            await writer.drain()

    return talk


def steady():
    return (line.encode(reading(k)) for k in itertools.count())


class Enough:
    """Sets `stop` after so many seconds' worth of IMU readings, and once a text was said.

    Parameters
    ----------
    seconds
        Of the IMU's clock, counted from the moment on at which the robot was heard if there is one that is.
    until
        Part of the text.
    poses
        How many of the robot's poses there must be.
    """

    def __init__(self, seconds, *, until="", with_robot=False, poses=0):
        self.stop, self.heard = asyncio.Event(), asyncio.Event()
        self._left_ns, self._until, self._waits, self._said = 1e9 * seconds, until, with_robot, not until
        self._poses = poses
        asyncio.get_running_loop().call_later(LIMIT, self.stop.set)

    def take(self, event):
        if not isinstance(event, Arrival):
            self._said = self._said or self._until in event.text
        elif isinstance(event.sample, RobotSample):
            self._waits = False
            self._poses -= 1
            self.heard.set()
        elif not self._waits:
            self._left_ns -= INTERVAL_NS
        if self._said and self._left_ns <= 0 and self._poses <= 0:
            self.stop.set()


async def record_until(enough, imu, robot, output):
    """Record until there is enough; addresses are texts."""
    addresses = parse_address(imu, IMUS), None if robot is None else parse_address(robot, ROBOTS)
    return await record(*addresses, output, stop=enough.stop, observe=enough.take)


async def run(tmp_path, imu_port, robot=None, seconds=1.0, imu="csv", options="", until="", enough=None):
    """Record, and return what the recorder says and what can be read of the file; see `Enough`."""
    enough = enough or Enough(seconds, until=until, with_robot=robot is not None and not until)
    status = await record_until(enough, f"{imu}://{HOST}:{imu_port}{options}", robot, tmp_path / "run")
    return status, tmp_path / "run"


def with_robot(tmp_path, datagrams, scheme="rsi", seconds=1.0, options="", until=""):
    """Record a steady IMU and what a controller sends."""

    async def all_of_it():
        port = free_port()
        async with serving(lines(steady)) as imu_port, sending(port, datagrams):
            return await run(tmp_path, imu_port, f"{scheme}://{HOST}:{port}{options}", seconds, until=until)

    return asyncio.run(all_of_it())


def with_imu(tmp_path, talk, seconds=1.0, imu="csv", options="", until=""):
    """Record an IMU alone."""

    async def all_of_it():
        async with serving(talk) as port:
            return await run(tmp_path, port, None, seconds, imu, options, until)

    return asyncio.run(all_of_it())


def said(status, text):
    assert any(text in note for note in status.notes), status.notes


def times_said(status, pattern):
    """Return the seconds that a pattern with one group finds in the notes."""
    return [float(found[1]) for note in status.notes if (found := re.search(pattern, note))]


def recorder(tmp_path, port, *more):
    command = [sys.executable, "-m", "kreisel.cli.main", "record", "--imu", f"csv://{HOST}:{port}", "-o", "run"]
    return subprocess.Popen([*command, *more], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

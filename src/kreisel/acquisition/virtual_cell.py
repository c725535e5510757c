"""A virtual cell in real time: simulated controller and IMU in separate processes, on the loopback interface."""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import socket
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from kreisel.devices.autopilot_simulator import AutopilotSimulator
from kreisel.devices.commanded_arm import CommandedArm
from kreisel.devices.ros2_simulator import FRAMES_AND_JOINTS, Ros2Simulator, free_domain
from kreisel.devices.simulators import (
    SHARED,
    Datagrams,
    Pace,
    TcpSimulator,
    ekrl_simulator,
    imu_samples,
    play_datagrams,
    robot_samples,
)
from kreisel.errors import DeviceError, KreiselError, ProtocolError
from kreisel.protocols import secondary, urscript
from kreisel.recording.recording import Recording

INTERVALS = {"rsi": 0.012, "rtde": 0.002, "egm": 0.004, "ekrl": 0.024, "varproxy": 0.004, "ros2": 0.002}
"""Default time between two poses of each kind of controller, s."""

_HOST = "127.0.0.1"
_TICK = 0.004  # s between two steps of an arm that takes moves: the shorter interval of RSI, and that of EGM
_STATE = 0.1  # s between two states on the script port: a controller sends about ten a second (`protocols.secondary`)
_HEAD_START = 0.2  # so that the controller reads the start time before the motion begins


@dataclass(frozen=True)
class Urls:
    """Addresses of the devices, as `kreisel record` takes them; and of the mover, if the arm takes moves."""

    robot: str
    imu: str
    mover: str | None = None


@contextmanager
def running(
    recording: Recording, robot: str, imu: str, *, speed: float = 1.0, robot_port: int = 0, imu_port: int = 0
) -> Iterator[tuple[Urls, list[BaseProcess]]]:
    """Yield the addresses of the two devices, and their processes; both are terminated on exit.

    The motion begins when a client asks the IMU for its readings, and ends with the recording.

    Parameters
    ----------
    robot, imu
        A protocol of `devices.address`, of those that are simulated.
    speed
        How many seconds pass in the cell in one second of real time.
    robot_port, imu_port
        0 for any free port; the number of the domain for `ros2`.

    Raises
    ------
    DeviceError
        If a port is not free.
    """
    context = multiprocessing.get_context("spawn")
    began = context.Value("d", -1.0)
    processes: list[BaseProcess] = []
    pipes = []
    ports = []
    domain = free_domain(_HOST)
    try:
        for what, scheme, port in (("robot", robot, robot_port), ("imu", imu, imu_port)):
            ours, theirs = context.Pipe()
            if scheme == "ros2":
                port = port or domain
            elif scheme in ("rsi", "egm", "mavlink") and not port:
                port = _free_port()
            process: BaseProcess = context.Process(
                target=_play, args=(what, scheme, port, recording, speed, began, theirs), daemon=True
            )
            process.start()
            processes.append(process)
            pipes.append(ours)  # a device ends when its end of the pipe breaks
            theirs.close()
            ports.append(_answer(ours, f"{scheme}://{_HOST}:{port}"))
        yield Urls(_url(robot, ports[0], f"&{FRAMES_AND_JOINTS}"), _url(imu, ports[1])), processes
    finally:
        for process in processes:
            process.terminate()
            process.join()
        for pipe in pipes:
            pipe.close()


COMMANDED = {"rtde": "urscript", "rsi": "ekrl", "ekrl": "ekrl"}
"""Protocol for sending moves to an arm, by the protocol with which it sends its pose."""

_MOVES_AT = {"rtde": "?script=", "ekrl": "?moves="}


@contextmanager
def commanded(recording: Recording, robot: str, imu: str) -> Iterator[tuple[Urls, list[BaseProcess]]]:
    """Yield the addresses of a cell whose arm takes moves.

    Parameters
    ----------
    robot
        One of `COMMANDED`: a Universal Robots arm, or a KUKA arm with RSI or with kreisel's program only.

    Raises
    ------
    SettingsError
        If the recording has no joint angles or no standstills.
    """
    CommandedArm(recording)  # so that errors are raised here
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process: BaseProcess = context.Process(target=_obey, args=(recording, robot, imu, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        of_robot, of_mover, of_imu = (_answer(ours, f"{imu}://{_HOST}") for _ in range(3))
        mover = f"{COMMANDED[robot]}://{_HOST}:{of_mover}"
        option = f"{_MOVES_AT[robot]}{of_mover}" if robot in _MOVES_AT else ""
        yield Urls(f"{robot}://{_HOST}:{of_robot}{option}", _url(imu, of_imu), mover), [process]
    finally:
        process.terminate()
        process.join()
        ours.close()


def _obey(recording: Recording, robot: str, imu: str, ready: Connection) -> None:
    """Run both devices of a cell whose arm takes moves, until the parent ends."""
    _run(_commanded_arm(recording, robot, imu, ready), ready)


async def _commanded_arm(recording: Recording, robot: str, imu: str, ready: Connection) -> None:
    cell, of_imu = CommandedArm(recording), _simulator("imu", imu)
    guard = _Guard(cell)
    listen = _take_lines(cell, guard) if robot == "rtde" else _take_telegrams(cell)
    of_robot = Datagrams("rsi", _HOST, _free_port()) if robot == "rsi" else TcpSimulator(robot, on_write=guard.heard)
    ready.send(await of_robot.open() if isinstance(of_robot, Datagrams) else await of_robot.serve(_HOST, 0))
    mover = await asyncio.start_server(listen, _HOST, 0)
    ready.send(int(mover.sockets[0].getsockname()[1]))
    ready.send(await of_imu.serve(_HOST, _free_place(imu)))
    now = time.monotonic()
    while True:
        await asyncio.sleep(_TICK)
        before, now = now, time.monotonic()
        guard.look(now)
        readings, poses = cell.advance(now - before)
        of_imu.send(readings)
        of_robot.send(poses)


def _simulator(what: str, scheme: str, on_client: Callable[[], None] = lambda: None) -> Any:
    """Return the simulated device of a protocol; it has the methods of `TcpSimulator`."""
    if scheme == "ros2":
        return Ros2Simulator(what, on_client)
    return AutopilotSimulator(on_client) if scheme == "mavlink" else TcpSimulator(scheme, on_client)


def _url(scheme: str, port: int, options: str = "") -> str:
    """Return the address of a device at a port, or in the domain of that number."""
    return f"ros2://{_HOST}?domain={port}{options}" if scheme == "ros2" else f"{scheme}://{_HOST}:{port}"


Listener = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[Any, Any, None]]


_LATE = 0.05
"""s between two looks of the watchdog from which this process was late. Chosen: some ticks, half a watchdog's time."""


class _Guard:
    """The watchdog of a program: it stops the arm when an RTDE input is no longer written."""

    def __init__(self, cell: CommandedArm) -> None:
        self._cell = cell
        self._heard = self._looked = -math.inf
        self._watchdog: urscript.Watchdog | None = None

    def heard(self) -> None:
        """Note that the input was written."""
        self._heard = time.monotonic()

    def watch(self, watchdog: urscript.Watchdog | None) -> None:
        """Watch from now on, with a watchdog or without one."""
        self._watchdog = watchdog
        self._heard = max(self._heard, time.monotonic() - _TICK)

    def look(self, now: float) -> None:
        """Stop the arm if the input was not written in time; a watchdog ends with its program.

        If this process was late itself, what it was sent meanwhile comes first.
        """
        if now - self._looked > _LATE:
            self._heard = now
        self._looked = now
        if not self._cell.moving:
            self._watchdog = None
        elif self._watchdog is not None and now - self._heard > SHARED / self._watchdog.least:
            self._cell.stop()


def _take_lines(cell: CommandedArm, guard: _Guard) -> Listener:
    """Return a handler of URScript connections; like a Universal Robots controller, it also sends its state."""

    async def send_states(writer: asyncio.StreamWriter) -> None:
        while not writer.is_closing():
            writer.write(secondary.encode_state(round(time.monotonic() * 1e6)))
            await asyncio.sleep(_STATE)

    async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        sending = asyncio.ensure_future(send_states(writer))
        with suppress(OSError, asyncio.CancelledError):
            watchdog = None
            while line := await reader.readline():
                watchdog = urscript.decode_watchdog(line) or watchdog
                with suppress(ProtocolError):
                    command = urscript.decode(line)
                    if isinstance(command, urscript.Stop):
                        cell.stop()
                    elif cell.move(command.target) is None:
                        guard.watch(watchdog)
                    watchdog = None
        sending.cancel()
        writer.close()

    return listen


def _take_telegrams(cell: CommandedArm) -> Listener:
    """Return a handler of telegram connections, like kreisel's program on a KUKA controller."""

    async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.CancelledError):
            await ekrl_simulator(cell, reader, writer)
        cell.stop()  # as the program does when no client is connected
        writer.close()

    return listen


def _answer(connection: Connection, address: str) -> int:
    try:
        found = connection.recv()
    except EOFError:
        raise DeviceError(f"{address}: the simulated device did not start") from None
    if isinstance(found, str):
        raise DeviceError(f"{address}: cannot be served: {found}")
    return int(found)


def _free_place(scheme: str) -> int:
    """Return where a simulated IMU may send to: a port, a domain, or 0 if clients connect to it."""
    if scheme == "ros2":
        return free_domain(_HOST)
    return _free_port() if scheme == "mavlink" else 0


def _free_port() -> int:
    """Return a free UDP port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])


def _play(what: str, scheme: str, port: int, recording: Recording, speed: float, began: Any, ready: Connection) -> None:
    """Run one device, in a separate process, until the recording or the parent ends."""
    _run(_device(what, scheme, port, recording, speed, began, ready), ready)


def _run(device: Coroutine[Any, Any, None], ready: Connection) -> None:
    """Run a device until it ends, or the parent's end of the pipe breaks."""

    async def until_end() -> None:
        task = asyncio.ensure_future(device)
        asyncio.get_running_loop().add_reader(ready.fileno(), task.cancel)
        await task

    with suppress(KeyboardInterrupt, asyncio.CancelledError):
        asyncio.run(until_end())


async def _device(
    what: str, scheme: str, port: int, recording: Recording, speed: float, began: Any, ready: Connection
) -> None:
    pace = Pace(lambda: began.value if began.value >= 0.0 else None, speed)
    samples: Any = robot_samples(recording) if what == "robot" else imu_samples(recording.imu)
    if scheme in ("rsi", "egm"):
        ready.send(port)
        await play_datagrams(scheme, samples, _HOST, port, pace)
        return

    def begin() -> None:
        if what == "imu" and began.value < 0.0:
            began.value = time.monotonic() + _HEAD_START

    simulator = _simulator(what, scheme, begin)
    try:
        ready.send(await simulator.serve(_HOST, port))
    except (OSError, KreiselError) as error:
        ready.send(getattr(error, "strerror", None) or str(error))
        return
    await simulator.play(samples, pace)

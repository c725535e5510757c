"""Recording the data of devices into one file that stays readable after a kill, a full disk or a lost device."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from kreisel.acquisition.streams import Stream
from kreisel.devices.address import Address
from kreisel.devices.events import Arrival, Event, Level
from kreisel.devices.opening import events
from kreisel.devices.replay import REPLAY
from kreisel.errors import DeviceError, KreiselError, RecordingError, SettingsError
from kreisel.formats.mcap import INFO, RECORDED, WARN, McapWriter
from kreisel.protocols.samples import ImuSample, RobotSample
from kreisel.recording.recording_settings import RecordingSettings

FLUSH = 0.1
"""Seconds between two flushes to the file: these and the data in queues are lost if the process is killed."""

SHOW = 0.5
"""Seconds between two calls of `show`."""

_SILENT = 2.0
"""s without a reading of a device from which on that is said. Chosen: references of one pose a second are in use."""

_QUEUE = 50_000
"""Events of two devices that may wait to be written. Chosen: 50 s of an IMU and an arm at 500 Hz, if a disk stalls;
limited, because a disk that no longer writes must not fill the memory."""


@dataclass
class Excitation:
    """The motion of the IMU so far: calibration needs rotations about all axes, and standstills.

    Attributes
    ----------
    turned : (3,)
        Integral of the absolute angular rate of each axis, rad.
    lowest, highest : (3,)
        Lowest and highest acceleration of each axis, m/s^2.
    """

    turned: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    lowest: list[float] = field(default_factory=lambda: [math.inf] * 3)
    highest: list[float] = field(default_factory=lambda: [-math.inf] * 3)

    def take(self, sample: ImuSample, seconds: float) -> None:
        """Take a reading, `seconds` after the one before."""
        for i in range(3):
            self.turned[i] += abs(sample.rate[i]) * seconds
            self.lowest[i] = min(self.lowest[i], sample.acceleration[i])
            self.highest[i] = max(self.highest[i], sample.acceleration[i])

    def missing(self) -> list[str]:
        """Return the motions that are still missing, in words."""
        out = [f"turn about {axis}" for axis, angle in zip("xyz", self.turned, strict=True) if angle < 2.0 * math.pi]
        for axis, low, high in zip("xyz", self.lowest, self.highest, strict=True):
            if not high - low > 9.0:
                out.append(f"turn {axis} up and down")
        return out


@dataclass
class Status:
    """The status of a recorder while it runs.

    `silent` holds for how long nothing came from a device, s, by its address, where that is long. `locked_out` says
    that another sender than the recorded one may be the robot; empty if there was none. `further` are the streams of
    IMUs after the first, which the excitation is of.
    """

    began_ns: int
    imu: Stream = field(default_factory=Stream)
    further: tuple[Stream, ...] = ()
    robot: Stream = field(default_factory=Stream)
    excitation: Excitation = field(default_factory=Excitation)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    written: int = 0
    silent: dict[str, float] = field(default_factory=dict)
    locked_out: str = ""

    @property
    def imus(self) -> tuple[Stream, ...]:
        """The streams of all IMUs, in the order of their units."""
        return (self.imu, *self.further)

    @property
    def empty(self) -> bool:
        """Whether no reading of any device has been received."""
        return not any(stream.count for stream in (*self.imus, self.robot))

    def complete(self, *, with_robot: bool) -> bool:
        """Return whether readings of every recorded device have been received."""
        return all(stream.count > 0 for stream in self.imus) and (self.robot.count > 0 or not with_robot)


Show = Callable[[Status], None]


class Recorder:
    """Writes readings and notes to an MCAP stream.

    Parameters
    ----------
    stream
        Open for writing, binary.
    settings, urdf
        Written first.
    unix_ns, host_ns
        The same moment on the host's two clocks: log times are monotonic times plus their difference.
    further
        Names of the IMUs after the first: readings of each have a topic of their own.
    """

    def __init__(
        self, stream: BinaryIO, settings: RecordingSettings, urdf: str | None, unix_ns: int, host_ns: int,
        further: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.status = Status(host_ns, further=tuple(Stream() for _ in further))
        self._units = {name: k for k, name in enumerate(further, 1)}
        self._stream = stream
        self._shift = unix_ns - host_ns
        self._writer = McapWriter(stream)
        self._writer.add_settings(settings)
        if urdf is not None:
            self._writer.add_urdf(urdf)
        self._imu_ns: int | None = None

    def take(self, source: str, event: Event) -> list[Event]:
        """Write an event of a device, by its name; return the events kept, among them readings held before."""
        if not isinstance(event, Arrival):
            self.status.locked_out = self.status.locked_out or (event.text if event.level is Level.LOCKED_OUT else "")
            self.note(event.text, event.host_ns, WARN if event.level is not Level.INFO else INFO)
            return [event]
        unit = self.unit_of(source)
        stream = self.status.imus[unit] if isinstance(event.sample, ImuSample) else self.status.robot
        kept, notes = stream.take(event)
        for text in notes:
            self.note(f"{source}: {text}", event.host_ns, WARN)
        for arrival in kept:
            self._write(arrival, stream.epoch, unit)
        return list(kept)

    def unit_of(self, source: str) -> int:
        """Return the number of the unit of an IMU by its name: 0 for the first one, and for the robot."""
        return self._units.get(source, 0)

    def _write(self, arrival: Arrival, epoch: int, unit: int) -> None:
        sample, log_ns = arrival.sample, arrival.host_ns + self._shift
        if isinstance(sample, RobotSample):
            self._pose(sample, log_ns, epoch)
            return
        self._writer.add_imu(sample.stamp_ns, sample.rate, sample.acceleration, log_ns, epoch, unit)
        if unit:
            return
        if self._imu_ns is not None:
            self.status.excitation.take(sample, min(0.1, max(0.0, (sample.stamp_ns - self._imu_ns) * 1e-9)))
        self._imu_ns = sample.stamp_ns

    def _pose(self, sample: RobotSample, log_ns: int, epoch: int) -> None:
        if sample.position is not None or sample.quaternion is not None:
            self._writer.add_pose(sample.stamp_ns, sample.position, sample.quaternion, log_ns, epoch)
        if sample.joints:
            self._writer.add_joints(sample.stamp_ns, sample.joints, log_ns, epoch)

    def note(self, text: str, host_ns: int, level: int = INFO) -> None:
        """Write a note."""
        self.status.notes.append(text)
        self._writer.add_note(host_ns + self._shift, level, "kreisel", text)

    def flush(self) -> None:
        """Write buffered data to the file."""
        self._writer.flush()
        self._stream.flush()
        self.status.written = self._stream.tell()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()
        self._stream.flush()


async def record(
    imu: Address,
    robot: Address | None,
    output: Path,
    *,
    further: Sequence[Address] = (),
    seconds: float | None = None,
    settings: RecordingSettings | None = None,
    urdf: str | None = None,
    stop: asyncio.Event | None = None,
    show: Show | None = None,
    observe: Callable[[Event], None] | None = None,
) -> Status:
    """Record for `seconds` from the moment readings of all devices are received, or until `stop` is set.

    If recordings are played in the place of devices, it also ends when they end. A file without any reading is removed,
    so that the command can be repeated.

    Parameters
    ----------
    output
        An .mcap file, or a folder in which one is created.
    further
        IMUs beside the first, on one rigid body with it: units of a tray.
    show
        Called twice a second, and at the end.
    observe
        Called with every event of robot and first IMU that is kept, after it is passed to the file.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written (earlier data are kept), or if a recording cannot be played.
    SettingsError, DeviceError
        If an address is invalid, given twice, or not free to listen on; data already received from another device are
        kept.
    """
    place = Place.of(output)
    if place.file.exists():
        raise RecordingError("exists already; delete it, or give another name", file=place.file)
    names = [str(address) for address in (imu, *further)]
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise SettingsError(f"--imu {twice[0]} is given twice, expected an address for each device; leave one out")
    addresses = [address for address in (imu, *further, robot) if address is not None]
    sources = [events(address) for address in addresses]
    stop = stop or asyncio.Event()
    queue: asyncio.Queue[tuple[str, Event]] = asyncio.Queue(_QUEUE * (2 + len(further)) // 2)
    recorder: Recorder | None = None
    try:
        place.file.parent.mkdir(parents=True, exist_ok=True)
        with place.file.open("xb") as stream:
            known, now = settings or RecordingSettings(), (time.time_ns(), time.monotonic_ns())
            recorder = Recorder(stream, known, urdf, *now, names[1:])
            feeding = [
                asyncio.create_task(_feed(str(address), source, queue))
                for address, source in zip(addresses, sources, strict=True)
            ]
            ending = [task for task, address in zip(feeding, addresses, strict=True) if address.scheme == REPLAY]
            try:
                await _write(recorder, queue, feeding, ending, stop, seconds, robot is not None, show, observe)
            except KreiselError:
                recorder.finish()  # the data received before are complete
                raise
            finally:
                for task in feeding:
                    task.cancel()
                await asyncio.gather(*feeding, return_exceptions=True)
            recorder.finish()
            if show is not None:
                show(recorder.status)
    except OSError as error:
        if recorder is None or recorder.status.empty:
            raise RecordingError(f"cannot be written: {error.strerror or error}", file=place.file) from error
        raise RecordingError(
            f"cannot be written any more ({error.strerror or error}); what was recorded before is kept: "
            f"run `kreisel recover {place.file}` to get a readable copy",
            file=place.file,
        ) from error
    except KreiselError as error:
        if recorder is None or recorder.status.empty or recorder.status.complete(with_robot=robot is not None):
            raise
        raise DeviceError(f"{error}; {place.kept_elsewhere()}") from error
    finally:
        if recorder is not None and recorder.status.empty:
            place.clear()
    return recorder.status


@dataclass(frozen=True)
class Place:
    """Where a recording is made: the user's path, the file, and the folders created for it."""

    output: Path
    file: Path
    made: tuple[Path, ...]

    @classmethod
    def of(cls, output: Path) -> Place:
        """Return the place of a recording before it begins: an .mcap file, or a folder in which one is created."""
        file = output if output.suffix == ".mcap" else output / RECORDED
        return cls(output, file, tuple(folder for folder in file.parents if not folder.exists()))

    def clear(self) -> None:
        """Remove a file without readings and the folders created for it, so that the command can be repeated."""
        with suppress(OSError):
            self.file.unlink()
            for folder in self.made:
                folder.rmdir()

    def kept_elsewhere(self) -> str:
        """Move a file with only one device's data next to the place, and return a text that says where it is."""
        whole = self.output.absolute()
        name = whole.stem if whole.suffix == ".mcap" else whole.name
        number = itertools.count(2)
        aside = whole.with_name(f"{name}_partial.mcap")
        while aside.exists():
            aside = whole.with_name(f"{name}_partial_{next(number)}.mcap")
        try:
            self.file.rename(aside)
        except OSError:
            return f"the data received are kept in {self.file}"
        with suppress(OSError):
            for folder in self.made:
                folder.rmdir()
        return f"the data received are kept in {aside}"


async def _feed(name: str, source: object, queue: asyncio.Queue[tuple[str, Event]]) -> None:
    async for event in source:  # type: ignore[attr-defined]
        await queue.put((name, event))


async def _write(
    recorder: Recorder,
    queue: asyncio.Queue[tuple[str, Event]],
    feeding: list[asyncio.Task[None]],
    ending: list[asyncio.Task[None]],
    stop: asyncio.Event,
    seconds: float | None,
    with_robot: bool,
    show: Show | None,
    observe: Callable[[Event], None] | None,
) -> None:
    """Write events until it is time to stop, or until all events of sources that end are written."""
    status, began = recorder.status, None
    heard: dict[str, float] = {}

    def take(name: str, event: Event) -> None:
        if isinstance(event, Arrival):
            heard[name] = time.monotonic()
        for kept in recorder.take(name, event):
            if observe is not None and not recorder.unit_of(name):
                observe(kept)

    def take_waiting() -> None:
        for _ in range(queue.qsize()):
            take(*queue.get_nowait())

    flushed = shown = time.monotonic()
    while not stop.is_set():
        for task in feeding:
            if task.done() and task.exception() is not None:
                raise task.exception()  # type: ignore[misc]
        if ending and all(task.done() for task in ending):
            take_waiting()
            return
        now = time.monotonic()
        if began is None and status.complete(with_robot=with_robot):
            began = now
        status.seconds = 0.0 if began is None else now - began
        status.silent = {name: now - at for name, at in heard.items() if now - at > _SILENT}
        if seconds is not None and began is not None and now - began >= seconds:
            return
        if now - flushed >= FLUSH:
            recorder.flush()
            flushed = now
        if show is not None and now - shown >= SHOW:
            show(status)
            shown = now
        try:
            async with asyncio.timeout(0.1):
                name, event = await queue.get()
        except TimeoutError:
            continue
        take(name, event)
        take_waiting()
        await asyncio.sleep(0.01)

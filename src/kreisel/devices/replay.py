"""A recording that replaces a device: its messages come at the recorded intervals, or faster, and then end."""

from __future__ import annotations

import asyncio
import heapq
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from kreisel.devices.address import Address
from kreisel.devices.events import Arrival, Event, Level, Notice
from kreisel.devices.simulators import Pace, imu_samples
from kreisel.formats.playback import Playback, Track, load_imu, load_robot
from kreisel.protocols.samples import LAST_STAMP_NS, ImuSample, RobotSample
from kreisel.recording.recording import ImuSamples, JointAngles, ReferencePoses

REPLAY = "mcap"
"""The scheme of addresses that are recordings."""

LATEST_NS = 60_000_000_000
"""A stream that begins so much later than its file was logged on another clock, as in files merged from others: it is
played from its first message at once."""

_TURN = 200  # messages after which other tasks may run, at any speed

Timed = tuple[int, ImuSample | RobotSample]


def replay(address: Address, clock: Callable[[], int]) -> AsyncIterator[Event]:
    """Return the events of a device whose messages are in a file.

    Stamps are those of the messages. The host's times are the log times, shifted to now: a new recording of them keeps
    all intervals between readings, at any speed.

    Raises
    ------
    SettingsError
        If an option of the address is invalid.
    RecordingError
        If the file cannot be played; see `load_imu`.
    """
    speed = address.number("speed", 1.0, 1e-3, 1e6)
    load = {"imu": load_imu, "robot": load_robot}[address.device]
    return _play(address, load(Path(address.path), address.options.get("topic")), speed, clock)


async def _play(address: Address, playback: Playback, speed: float, clock: Callable[[], int]) -> AsyncIterator[Event]:
    begun_ns, began = clock(), time.monotonic()
    pace = Pace(lambda: began, speed)
    for warning in playback.warnings:
        yield Notice(Level.WARNING, f"{address}: {warning}", begun_ns)
    yield Notice(Level.INFO, f"{address}: {_names(playback)} is played at {speed:g} times real time", begun_ns)
    first_ns = now_ns = None
    refused = 0
    for number, (log_ns, sample) in enumerate(_timed(playback)):
        if first_ns is None:
            first_ns = log_ns if log_ns - playback.begun_ns > LATEST_NS else playback.begun_ns
        if not _possible(sample):
            refused += 1
            continue
        now_ns = log_ns - first_ns
        await pace.until(now_ns * 1e-9)
        if number % _TURN == 0:
            await asyncio.sleep(0)
        yield Arrival(sample, begun_ns + now_ns)
    if refused:
        text = f"{address}: {refused} messages left out: values not finite, or stamps outside the range of a recording"
        yield Notice(Level.WARNING, text, begun_ns + (now_ns or 0))
    yield Notice(Level.INFO, f"{address}: has ended", begun_ns + (now_ns or 0))


def _names(playback: Playback) -> str:
    tracks: list[Track[ImuSamples] | Track[ReferencePoses] | Track[JointAngles] | None]
    tracks = [playback.imu, playback.poses, playback.joints]
    names = [f"/{track.content.source.relative_to(playback.file)}" for track in tracks if track is not None]
    return " with ".join(names)


def _timed(playback: Playback) -> Iterator[Timed]:
    """Yield readings with their log times; a pose and joint angles with the same stamp are one reading."""
    if playback.imu is not None:
        yield from zip(playback.imu.log_times_ns.tolist(), imu_samples(playback.imu.content), strict=True)
    poses = () if playback.poses is None else _poses(playback.poses)
    joints = () if playback.joints is None else _angles(playback.joints)
    merged = heapq.merge(poses, joints, key=_stamp)  # of two with the same stamp the pose comes first
    for _, group in groupby(merged, key=_stamp):
        times, samples = zip(*group, strict=True)
        yield min(times), replace(samples[0], joints=next((s.joints for s in samples if s.joints), ()))


def _poses(track: Track[ReferencePoses]) -> Iterator[tuple[int, RobotSample]]:
    p, q = track.content.positions, track.content.quaternions
    stamps = track.content.stamps_ns.tolist()
    for k, (log_ns, stamp_ns) in enumerate(zip(track.log_times_ns.tolist(), stamps, strict=True)):
        position = None if p is None else tuple(p[k].tolist())
        yield log_ns, RobotSample(stamp_ns, position, None if q is None else tuple(q[k].tolist()))


def _angles(track: Track[JointAngles]) -> Iterator[tuple[int, RobotSample]]:
    stamps = track.content.stamps_ns.tolist()
    for k, (log_ns, stamp_ns) in enumerate(zip(track.log_times_ns.tolist(), stamps, strict=True)):
        yield log_ns, RobotSample(stamp_ns, None, None, tuple(track.content.angles[k].tolist()))


def _stamp(timed: tuple[int, RobotSample]) -> int:
    return timed[1].stamp_ns


def _possible(sample: ImuSample | RobotSample) -> bool:
    """Return whether a reading can be recorded: the same checks as in the protocols."""
    if isinstance(sample, ImuSample):
        values: tuple[float, ...] = (*sample.rate, *sample.acceleration)
    else:
        values = (*(sample.position or ()), *(sample.quaternion or ()), *sample.joints)
    return 0 <= sample.stamp_ns <= LAST_STAMP_NS and all(map(math.isfinite, values))

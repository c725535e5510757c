"""Recordings written as MCAP files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import RecordingError
from kreisel.files import open_fresh
from kreisel.formats.mcap import McapWriter
from kreisel.recording.recording import ImuSamples, JointAngles, Recording, ReferencePoses, Stamps

_LAST_STAMP = 2**31 * 10**9 - 1  # seconds are an int32 in a ROS header


def write_mcap(recording: Recording, path: Path, further: Mapping[str, ImuSamples] | None = None) -> None:
    """Write a recording as one MCAP file; the log time of a message is its header's stamp.

    Parameters
    ----------
    further
        Readings of further units by their names, imu1, imu2, ….

    Raises
    ------
    RecordingError
        If the file exists or cannot be written, or a stamp does not fit a ROS header.
    """
    if path.exists():
        raise RecordingError("exists already; delete it, or give another name", file=path)
    imus = {0: recording.imu} | {int(name.removeprefix("imu")): imu for name, imu in (further or {}).items()}
    for stream in _streams(recording, imus):
        _check_stamps(stream.stamps_ns, stream.source)
    part = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_fresh(part) as file:
            _write_all(recording, imus, McapWriter(file))
        part.replace(path)
    except OSError as error:
        raise RecordingError(f"cannot be written: {error.strerror}", file=path) from error
    finally:
        with suppress(OSError):
            part.unlink()


def _streams(recording: Recording, imus: Mapping[int, ImuSamples]) -> list[Any]:
    return [one for one in (*imus.values(), recording.reference, recording.joints) if one is not None]


def _check_stamps(stamps: Stamps, source: Path) -> None:
    outside = np.flatnonzero((stamps < 0) | (stamps > _LAST_STAMP))
    if outside.size:
        raise RecordingError(
            f"the stamp {stamps[outside[0]]} ns does not fit a ROS header, expected 0 to {_LAST_STAMP} ns; "
            "shift all stamps of the recording by one constant, or write a folder",
            file=source,
        )


def _write_all(recording: Recording, imus: Mapping[int, ImuSamples], writer: McapWriter) -> None:
    """Write settings and streams, merged in the order of their stamps."""
    writer.add_settings(recording.settings)
    if recording.urdf is not None:
        writer.add_urdf(recording.urdf)
    adders = [_imu_adder(unit, imu, writer) for unit, imu in imus.items()]
    if recording.reference is not None:
        adders.append(_pose_adder(recording.reference, writer))
    if recording.joints is not None:
        adders.append(_joint_adder(recording.joints, writer))
    streams = _streams(recording, imus)
    stamps = np.concatenate([stream.stamps_ns for stream in streams])
    owner = np.repeat(np.arange(len(streams)), [stream.stamps_ns.size for stream in streams])
    index = np.concatenate([np.arange(stream.stamps_ns.size) for stream in streams])
    order = np.argsort(stamps, kind="stable")
    for which, stamp, k in np.column_stack([owner, stamps, index])[order].tolist():
        adders[which](stamp, k)
    writer.finish()


def _imu_adder(unit: int, imu: ImuSamples, writer: McapWriter) -> Callable[[int, int], None]:
    return lambda stamp, k: writer.add_imu(stamp, imu.rates[k].tolist(), imu.accelerations[k].tolist(), unit=unit)


def _pose_adder(reference: ReferencePoses, writer: McapWriter) -> Callable[[int, int], None]:
    p, q = reference.positions, reference.quaternions
    return lambda stamp, k: writer.add_pose(
        stamp, None if p is None else p[k].tolist(), None if q is None else q[k].tolist()
    )


def _joint_adder(joints: JointAngles, writer: McapWriter) -> Callable[[int, int], None]:
    return lambda stamp, k: writer.add_joints(stamp, joints.angles[k].tolist())

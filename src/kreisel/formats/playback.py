"""The data of one device in an MCAP file, with their times of arrival, to be played back in place of the device."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from io import SEEK_END
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from mcap.writer import MCAP0_MAGIC

from kreisel.errors import RecordingError
from kreisel.formats.bag import REFERENCE_ROLE, body_of, imu_of, joints_of, poses_of
from kreisel.formats.bag_messages import REFERENCE_ROWS, decode_topic
from kreisel.formats.bag_topics import IMU_ROLE, Role, choose_topic, joint_topic, listed
from kreisel.formats.mcap import RECORDED, Contents, Topic, check_magic, read_mcap
from kreisel.formats.topic_names import IMU, JOINTS
from kreisel.recording.recording import DataWarning, ImuSamples, JointAngles, ReferencePoses, Stamps

Content = TypeVar("Content", ImuSamples, ReferencePoses, JointAngles)

_OPTION = "?topic="
_IMU_ROLE = replace(IMU_ROLE, option=_OPTION)
_POSE_ROLE = replace(REFERENCE_ROLE, option=_OPTION)
_ROBOT_ROLE = Role("poses or joint angles", _OPTION, frozenset({*REFERENCE_ROWS, JOINTS}), ())


@dataclass(frozen=True)
class Track(Generic[Content]):
    """One topic: the content of its messages, and the host's times of their arrival."""

    content: Content
    log_times_ns: Stamps


@dataclass(frozen=True)
class Playback:
    """The data of one device.

    Attributes
    ----------
    begun_ns
        The earliest log time in the file.
    """

    file: Path
    begun_ns: int
    imu: Track[ImuSamples] | None = None
    poses: Track[ReferencePoses] | None = None
    joints: Track[JointAngles] | None = None
    warnings: tuple[DataWarning, ...] = ()


def load_imu(path: Path, topic: str | None = None) -> Playback:
    """Return the data of an IMU.

    Parameters
    ----------
    path
        An .mcap file, or the folder of a recording that was made live.
    topic
        As `TOPIC` or `TOPIC@FRAME_ID`; by default kreisel's own, or the only one in the file.

    Raises
    ------
    RecordingError
        If there is no such file or topic, the file is not an MCAP file, or it is not finished; the message lists the
        topics in the file.
    """
    contents, warnings = _read(path, {IMU}), list[DataWarning]()
    body = body_of(contents, _IMU_ROLE, topic, warnings, decode_topic)
    imu = imu_of(body, contents, _IMU_ROLE)
    assert body is not None  # noqa: S101 - for the type checker; without one there is an error above
    return Playback(
        contents.path, contents.begun_ns or 0, Track(imu, _logged(body.topic)[body.keep]),
        warnings=(*contents.warnings, *warnings),
    )  # fmt: skip


def load_robot(path: Path, topic: str | None = None) -> Playback:
    """Return the data of a robot: poses, and the joint angles on their clock; see `load_imu`.

    Parameters
    ----------
    topic
        Of poses or of one part of them; of joint angles, to play back only these.
    """
    contents, warnings = _read(path, {*REFERENCE_ROWS, JOINTS}), list[DataWarning]()
    poses = joints = None
    named = None if topic is None else choose_topic(contents, _ROBOT_ROLE, topic, [])[0]
    if named is not None and named.msgtype == JOINTS:
        joints = _joints(named, contents, warnings)
    else:
        poses = _poses(topic, contents, warnings)
        angles = joint_topic(contents, None if poses is None else poses.content.name, warnings)
        joints = None if angles is None else _joints(angles, contents, warnings)
    if poses is not None and joints is not None and not _overlap(poses.content.stamps_ns, joints.content.stamps_ns):
        warnings.append(
            DataWarning("joints", "left out, because their stamps and those of the poses are of different times")
        )
        joints = None
    if poses is None and joints is None:
        raise RecordingError(
            f"no poses and no joint angles of a robot; got {listed(contents.topics) or 'no topics'}",
            file=contents.path,
        )
    return Playback(
        contents.path, contents.begun_ns or 0, poses=poses, joints=joints, warnings=(*contents.warnings, *warnings)
    )


def _read(path: Path, wanted: Collection[str]) -> Contents:
    file = _file(path)
    try:
        with file.open("rb") as stream:
            check_magic(stream.read(len(MCAP0_MAGIC)), file)
            size = stream.seek(0, SEEK_END)
            stream.seek(max(len(MCAP0_MAGIC), size - len(MCAP0_MAGIC)))
            finished = stream.read() == MCAP0_MAGIC
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=file) from error
    if not finished:
        raise RecordingError(
            "is still being written, or was cut: it does not end as MCAP files do; wait until its recorder has ended, "
            f"or repair it: kreisel recover {file}",
            file=file,
        )
    return read_mcap(file, wanted)


def _file(path: Path) -> Path:
    """Return the file of a path, which may be the folder it was made in."""
    if not path.exists():
        raise RecordingError("no such file; a recording is played back from mcap:///PATH/FILE.mcap", file=path)
    if not path.is_dir():
        return path
    files = [path / RECORDED] if (path / RECORDED).is_file() else sorted(path.glob("*.mcap"))
    if len(files) != 1:
        names = ", ".join(file.name for file in files) or "none"
        raise RecordingError(f"the folder holds {len(files)} .mcap files ({names}), expected one; name it", file=path)
    return files[0]


def _poses(topic: str | None, contents: Contents, warnings: list[DataWarning]) -> Track[ReferencePoses] | None:
    body = body_of(contents, _POSE_ROLE, topic, warnings, decode_topic)
    poses = poses_of(body, contents.path)
    return None if body is None or poses is None else Track(poses, _logged(body.topic)[body.keep])


def _joints(topic: Topic, contents: Contents, warnings: list[DataWarning]) -> Track[JointAngles]:
    return Track(joints_of(topic, contents.path, warnings, decode_topic), _logged(topic))


def _logged(topic: Topic) -> Stamps:
    return np.array(topic.log_times_ns, dtype=np.int64)


def _overlap(a: Stamps, b: Stamps) -> bool:
    """Return whether stamps may be of one clock."""
    return bool(a.min() <= b.max() and b.min() <= a.max())

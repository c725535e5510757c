"""Recordings in ROS bags and MCAP files: choice of topics, and decoding of their messages."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from kreisel.errors import RecordingError, one_line, reason, unknown_name
from kreisel.files import MAX_YAML, read_text
from kreisel.formats.bag_frames import frame_poses, frame_topics
from kreisel.formats.bag_messages import (
    POINT,
    REFERENCE_ROWS,
    TURN,
    WANTED,
    Decode,
    Decoded,
    decode_topic,
    deserializer,
    translated,
)
from kreisel.formats.bag_topics import (
    IMU_ROLE,
    Role,
    choose_topic,
    joint_topic,
    later_parts,
    listed,
    unit_of,
    unit_topics,
)
from kreisel.formats.bounds import bounded, check_files, unpack, unzstd
from kreisel.formats.budget import Budget
from kreisel.formats.mcap import NO_LIMIT, RECORDED, WARN, Contents, Only, Topic, in_log_order, read_mcap, stated_topics
from kreisel.formats.robot_description import description_beside
from kreisel.formats.topic_names import (
    FRAMES,
    IMU,
    IMU_TOPIC,
    JOINTS,
    NOTE_TYPE,
    ORIENTATION_TOPIC,
    POSE_TOPIC,
    POSITION_TOPIC,
)
from kreisel.geometry.rotation import Array
from kreisel.recording.recording import (
    DataWarning,
    ImuSamples,
    JointAngles,
    Recording,
    ReferencePoses,
    Stamps,
)
from kreisel.recording.recording_settings import RecordingSettings, read_settings, what_is_wrong, with_units_together

REFERENCE_ROLE = Role(
    "reference poses",
    "--reference ",
    frozenset(REFERENCE_ROWS),
    (POSE_TOPIC, POSITION_TOPIC, ORIENTATION_TOPIC),
)


def load_bag(path: Path, reference: str | None = None, imu: str | None = None) -> Recording:
    """Return the recording in an MCAP file, a ROS 1 bag, a ROS 2 bag folder or one of its files.

    Parameters
    ----------
    path
        An .mcap file (also a truncated one), a .bag or .db3 file, or a folder with metadata.yaml.
    reference, imu
        Topics, as `TOPIC` or, where bodies share a topic, as `TOPIC@FRAME_ID`; of frames as `TOPIC@TOOL` or
        `TOPIC@BASE:TOOL`. By default kreisel's own, or the only one of a fitting type.

    Raises
    ------
    RecordingError
        If the file cannot be read, the choice of a topic is not clear, or a topic does not hold what is
        needed; the message lists the topics and says how to choose one.

    Notes
    -----
    Stamps are those of the headers; times of logging are used only where the stamp of every header is zero. Types are
    those that ROS defines: definitions stored in the file are not used.
    """
    with on_one_line():
        only = None if imu is None else topic_of_unit(path, imu)
        contents = read_contents(path, NO_LIMIT if only is None else {IMU: {only}})
        return recording_of(_with_frames(contents, reference), reference, imu)


@contextmanager
def on_one_line() -> Iterator[None]:
    """Turn the messages of errors into single lines: names in a damaged file may contain line breaks."""
    try:
        yield
    except RecordingError as error:
        raise RecordingError(one_line(error.message), file=error.file, line=error.line) from error.__cause__


def recording_of(
    contents: Contents, reference: str | None = None, imu: str | None = None, decode: Decode | None = None
) -> Recording:
    """Return the recording in the contents of a bag; see `load_bag`.

    Parameters
    ----------
    decode
        Function that returns stamps, keys and rows of a topic's messages; it may keep those decoded before.
    """
    path, warnings, decode = contents.path, list(contents.warnings), decode or decode_topic
    settings = _settings(contents, warnings)
    later = [] if imu is not None or _refers(contents) else later_parts(contents.topics, IMU_TOPIC)
    first = replace(contents, topics=tuple(topic for topic in contents.topics if topic not in later))
    body = body_of(first, IMU_ROLE, imu, warnings, decode)
    samples = imu_of(body, contents)
    if body is not None and body.topic.name == IMU_TOPIC:
        samples = _joined(samples, body.topic, [(topic, decode(topic, path)) for topic in later], warnings)
    settings = settings if body is None else settings.of_imu(unit_of(body.topic.name, contents.topics))
    if frame_topics(contents, reference):
        poses = frame_poses(contents, reference, warnings)
    else:
        poses = poses_of(body_of(contents, REFERENCE_ROLE, reference, warnings, decode), path)
    joints = _joint_angles(contents, None if poses is None else poses.name, warnings, decode)
    warnings += _notes(contents)
    urdf = contents.urdf or description_beside(path.parent, settings)
    return Recording(path, samples, poses, joints, settings, tuple(warnings), urdf=urdf)


def _refers(contents: Contents) -> bool:
    """Return whether a bag holds anything that readings of an IMU are compared with, on a clock of its own."""
    return any(topic.msgtype in REFERENCE_ROWS or topic.msgtype == JOINTS for topic in contents.topics if topic.count)


def _joined(
    imu: ImuSamples, first: Topic, later: Sequence[tuple[Topic, Decoded]], warnings: list[DataWarning]
) -> ImuSamples:
    """Return the readings together with those after the device's clock leapt, on one clock: by their times of arrival.

    These are good to some milliseconds: a step that counts as a gap remains, so that no turn is measured across it.
    """
    if not later:
        return imu
    stamps, values = [imu.stamps_ns], [np.hstack([imu.rates, imu.accelerations])]
    arrived = first.log_times_ns[0] - int(imu.stamps_ns[0])
    for topic, (own, _, rows) in later:
        begun = topic.log_times_ns[0] - arrived
        begun = max(begun, int(stamps[-1][-1]) + _APART_NS)
        stamps.append(own - own[0] + begun)
        values.append(np.asarray(rows, dtype=np.float64)[:, :6])
    text = (
        f"the device's clock leapt, at {', '.join(f'{(s[0] - stamps[0][0]) * 1e-9:.1f} s' for s in stamps[1:])}: the "
        "readings before and after are joined by their times of arrival"
    )
    warnings.append(DataWarning("clock", text))
    joined = np.vstack(values)
    return ImuSamples(np.concatenate(stamps), joined[:, :3].copy(), joined[:, 3:].copy(), imu.source)


_SOON = 10.0
"""Usual steps after which the second message of a clock that begins at zero has come. Chosen: some may be lost."""

_APART_NS = 200_000_000
"""ns: smallest step between the readings before a jump of the clock and those after it. Chosen: four times a gap."""


def notes_of(contents: Contents) -> list[tuple[int, str]]:
    """Return level and text of a recorder's notes."""
    notes = []
    for topic in contents.topics:
        if topic.msgtype == NOTE_TYPE and topic.encoding == "cdr":
            with translated(contents.path, "record again", f"a note on {topic.name}"):
                messages = [deserializer("cdr")(payload, NOTE_TYPE) for payload in topic.payloads]
            notes += [(int(message.level), one_line(message.msg)) for message in messages]
    return notes


def _notes(contents: Contents) -> list[DataWarning]:
    """Return warnings about notes of lost readings: the first few, and the number of others."""
    texts = [text for level, text in notes_of(contents) if level >= WARN]
    more = [f"and {len(texts) - 3} more such notes"] if len(texts) > 4 else []
    return [DataWarning("while recording", text) for text in texts[: 3 if more else 4] + more]


# Files -> messages


def topics_in(path: Path) -> tuple[Topic, ...]:
    """Return the topics of a bag with their numbers of messages, without the messages.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    files = [path] if path.suffix.lower() == ".mcap" and path.is_file() else sorted(path.glob("*.mcap"))
    try:
        parts = [stated_topics(file) for file in files]
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=path) from error
    if not parts or None in parts:
        with on_one_line():
            return read_contents(path, dict.fromkeys(WANTED, ())).topics
    groups: dict[tuple[str, str, str], int] = defaultdict(int)
    for topic in (topic for part in parts for topic in part or ()):
        groups[topic.name, topic.msgtype, topic.encoding] += topic.count
    return tuple(Topic(*key, count) for key, count in groups.items())


def topic_of_unit(path: Path, imu: str) -> str | None:
    """Return the topic with an IMU's readings in a bag, asked for as for `load_bag`; None if there is none."""
    topics = topics_in(path)
    named = {topic.name for topic in topics if topic.msgtype == IMU}
    name = imu.partition("@")[0]
    found = next((one for one in (name, f"/{name}") if one in named), None)
    return found or unit_topics(topics, everything=True).get(name)


def read_contents(path: Path, only: Only = NO_LIMIT) -> Contents:
    """Return the contents of a bag of any kind: messages of types that a recording uses.

    Parameters
    ----------
    only
        As for `read_mcap`; those of frames are kept only if they are in it.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    if not path.exists():
        raise RecordingError("no such file or folder; give an .mcap, .bag or .db3 file or a folder", file=path)
    only = {**dict.fromkeys(FRAMES, ()), **only}
    if path.is_file() and path.suffix.lower() == ".mcap":
        return read_mcap(path, _READ, only)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else []
    if [file.name for file in files] == [RECORDED]:
        return read_mcap(files[0], _READ, only)
    warnings: list[DataWarning] = []
    if files and (mode := _compression(path, warnings)) is not None:
        return _read_each(path, files, warnings, only, packed=mode == "message")
    zipped = sorted(path.glob("*.mcap.zstd")) if path.is_dir() else []
    if zipped:
        with TemporaryDirectory() as folder:
            with translated(path, _RECOVER):
                files = [unpack(file, Path(folder) / file.stem) for file in zipped]
            return _read_each(path, files, warnings, only, packed=False)
    with translated(path, _REINDEX if path.suffix.lower() == ".bag" else _RECOVER):
        return _read_with_rosbags(path, only)


def _with_frames(contents: Contents, reference: str | None) -> Contents:
    """Return the contents with the messages of frames, where these are the reference."""
    if not frame_topics(contents, reference):
        return contents
    every = [topic.name for topic in contents.topics if topic.msgtype in FRAMES]
    read = read_contents(contents.path, {**dict.fromkeys(WANTED, ()), **dict.fromkeys(FRAMES, every)})
    frames = {topic.name: topic for topic in read.topics if topic.msgtype in FRAMES}
    return replace(contents, topics=tuple(frames.get(topic.name, topic) for topic in contents.topics))


def _compression(folder: Path, warnings: list[DataWarning]) -> str | None:
    """Return how messages in the .mcap files of a ROS 2 bag are compressed; None where the bag has other files."""
    file = folder / "metadata.yaml"
    if not file.is_file():
        text = "no metadata.yaml, as after a recorder was stopped; read its .mcap files"
        warnings.append(DataWarning(folder.name, text))
        return "none"
    try:
        facts = YAML(typ="safe").load(read_text(file, MAX_YAML))["rosbag2_bagfile_information"]
        mode = str(facts.get("compression_mode") or "none").lower()
        return mode if facts["storage_identifier"] == "mcap" and mode in ("none", "message") else None
    except (
        OSError,
        UnicodeDecodeError,
        YAMLError,
        AttributeError,
        KeyError,
        TypeError,
        ValueError,
        RecursionError,
    ) as error:
        text = f"metadata.yaml cannot be read ({reason(error)}); read its .mcap files one by one"
        warnings.append(DataWarning(folder.name, text))
        return "none"


_READ = WANTED.union(FRAMES)

_REINDEX = "if its recorder was stopped, `rosbag reindex` may repair it; otherwise copy it again"
_RECOVER = "copy it again, or rebuild the bag with `ros2 bag reindex`"


def _read_with_rosbags(path: Path, only: Only) -> Contents:
    is_ros1 = path.suffix.lower() == ".bag" and path.is_file()
    messages: dict[tuple[str, str], list[tuple[int, bytes]]] = defaultdict(list)
    counts: dict[tuple[str, str], int] = defaultdict(int)
    check_files(path)
    budget = Budget(sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path])))
    with Ros1Reader(path) if is_ros1 else Ros2Reader(path) as reader:
        unpack = bounded(reader)
        for connection in reader.connections:
            counts[connection.topic, connection.msgtype] += connection.msgcount
        wanted = [
            one
            for one in reader.connections
            if one.msgtype in _READ and one.topic in only.get(one.msgtype, (one.topic,))
        ]
        # An empty list would mean all connections.
        for connection, log_time, payload in reader.messages(wanted) if wanted else ():
            content = unpack(payload)
            budget.take(len(content))
            messages[connection.topic, connection.msgtype].append((log_time, content))
    encoding = "ros1" if is_ros1 else "cdr"
    topics = [in_log_order(*key, encoding, count, messages[key]) for key, count in counts.items()]
    return Contents(path, tuple(topics))


def _read_each(path: Path, files: list[Path], earlier: list[DataWarning], only: Only, *, packed: bool) -> Contents:
    """Return the contents of several MCAP files as if they were one.

    Parameters
    ----------
    packed
        Whether each message is compressed by itself.
    """
    parts = [read_mcap(file, _READ, only) for file in files]
    groups: dict[tuple[str, str, str], list[Topic]] = defaultdict(list)
    settings: dict[str, str] = {}
    urdf = None
    budget = Budget(sum(file.stat().st_size for file in files))
    for part in parts:
        settings.update(part.settings)
        urdf = urdf or part.urdf
        for topic in part.topics:
            groups[topic.name, topic.msgtype, topic.encoding].append(topic)
    topics = []
    for key, group in groups.items():
        messages = [m for topic in group for m in zip(topic.log_times_ns, topic.payloads, strict=True)]
        if packed:
            with translated(path, _RECOVER, f"a message on {key[0]}"):
                messages = [(log_time, _decompressed(payload, budget)) for log_time, payload in messages]
        topics.append(in_log_order(*key, sum(topic.count for topic in group), messages))
    warnings = [*earlier, *(f for part in parts for f in part.warnings)]
    return Contents(path, tuple(topics), settings, tuple(warnings), urdf)


def _decompressed(payload: bytes, budget: Budget) -> bytes:
    content = unzstd(payload)
    budget.take(len(content))
    return content


# Settings


def _settings(contents: Contents, warnings: list[DataWarning]) -> RecordingSettings:
    path, stored = contents.path, contents.settings
    settings_file = path / "recording.toml" if path.is_dir() else path.with_suffix(".toml")
    if settings_file.is_file():
        if stored:
            warnings.append(
                DataWarning("settings", f"taken from {settings_file.name}, not those stored in {path.name}")
            )
        return read_settings(settings_file)
    tables: dict[str, dict[str, str]] = defaultdict(dict)
    for name, text in stored.items():
        table, _, key = name.partition(".")
        tables[table][key] = text
    try:
        return RecordingSettings.model_validate(with_units_together(tables))
    except ValidationError as error:
        raise RecordingError(
            f"the stored setting {what_is_wrong(error)}; write the right ones into {settings_file.name} next to it",
            file=path,
        ) from error


# Which topic


@dataclass(frozen=True)
class Body:
    """The decoded messages of one body on one topic; `keep` is their mask in all messages of the topic."""

    topic: Topic
    stamps_ns: Stamps
    values: Array
    keep: NDArray[np.bool_]


def body_of(
    contents: Contents, role: Role, asked: str | None, warnings: list[DataWarning], decode: Decode
) -> Body | None:
    """Return the chosen messages; None where none were asked for and the bag has none; see `choose_topic`."""
    path = contents.path
    topic, frame = choose_topic(contents, role, asked, warnings)
    if topic is None:
        return None
    stamps, frames, rows = decode(topic, path)
    stamps, stamped = _stamps(stamps, topic, warnings)
    keep = stamped & _of_frame(frames, frame, topic, role, path)
    return Body(topic, stamps[keep], np.array(rows, dtype=np.float64)[keep], keep)


def _of_frame(frames: list[str], frame: str | None, topic: Topic, role: Role, path: Path) -> Any:
    """Return the mask of one body's messages; bodies on one topic are distinguished by their frame id."""
    known = sorted(set(frames))
    if frame is not None and frame not in known:
        raise RecordingError(unknown_name(f"frame id on {topic.name}", frame, known), file=path)
    if frame is None and len(known) > 1:
        listed = " or ".join(f"{role.option}'{topic.name}@{name}'" for name in known)
        raise RecordingError(
            f"{len(known)} bodies share the topic {topic.name}, with the frame ids "
            f"{', '.join(repr(name) for name in known)}; expected one. Choose with {listed}",
            file=path,
        )
    return np.array([frame is None or name == frame for name in frames])


def _stamps(stamps: Stamps, topic: Topic, warnings: list[DataWarning]) -> tuple[Stamps, NDArray[np.bool_]]:
    """Return the stamps of messages, and which messages have one.

    Drivers stamp messages zero before they know the time. Where they never do, times of logging are the stamps.
    """
    stamped = stamps != 0
    if not stamped.any():
        message = f"every header on {topic.name} is stamped zero; took the times of logging, which jitter"
        warnings.append(DataWarning("stamps", message))
        return np.array(topic.log_times_ns, dtype=np.int64), ~stamped
    if _begins_at_zero(stamps, stamped):
        return stamps, ~np.zeros_like(stamped)
    if not stamped.all():
        text = f"left out {np.sum(~stamped)} messages on {topic.name} whose headers are stamped zero"
        warnings.append(DataWarning("stamps", text))
    return stamps, stamped


def _begins_at_zero(stamps: Stamps, stamped: NDArray[np.bool_]) -> bool:
    """Return whether a clock begins at zero, as of a simulation: one message is stamped so, the next soon after it."""
    if np.sum(~stamped) != 1 or np.sum(stamped) < 2:
        return False
    later = np.sort(stamps[stamped])
    return bool(0 < later[0] <= _SOON * np.median(np.diff(later)))


def _source(path: Path, topic: Topic) -> Path:
    """Return a name of the messages: the file, then the topic."""
    return path / topic.name.lstrip("/")


def imu_of(body: Body | None, contents: Contents, role: Role = IMU_ROLE) -> ImuSamples:
    """Return the IMU readings in the messages of a body.

    Raises
    ------
    RecordingError
        If there are none, or they lack rates or accelerations.
    """
    if body is None:
        raise RecordingError(_no_imu(contents), file=contents.path)
    for mark, quantity in ((6, "angular_velocity"), (7, "linear_acceleration")):
        without = int(np.sum(body.values[:, mark] == -1.0))
        if without:
            raise RecordingError(
                f"{without} of {len(body.values)} messages on {body.topic.name} have no {quantity}, because their "
                f"{quantity}_covariance[0] is -1; both are needed. Choose another topic with {role.option}TOPIC",
                file=contents.path,
            )
    rates, accelerations = body.values[:, 0:3].copy(), body.values[:, 3:6].copy()
    return ImuSamples(body.stamps_ns, rates, accelerations, _source(contents.path, body.topic))


def _no_imu(contents: Contents) -> str:
    got = listed(contents.topics) or "no topics"
    broken = "".join(f" ({warning.message})" for warning in contents.warnings)
    return f"no IMU readings; expected a topic of type {IMU}, got {got}{broken}; record the IMU's raw topic"


def poses_of(body: Body | None, path: Path) -> ReferencePoses | None:
    """Return the poses in the messages of a body."""
    if body is None:
        return None
    positions = None if body.topic.msgtype == TURN else body.values[:, :3].copy()
    quaternions = None if body.topic.msgtype == POINT else body.values[:, -4:].copy()
    return ReferencePoses(body.topic.name, body.stamps_ns, positions, quaternions, _source(path, body.topic))


def _joint_angles(
    contents: Contents, reference: str | None, warnings: list[DataWarning], decode: Decode
) -> JointAngles | None:
    topic = joint_topic(contents, reference, warnings)
    return None if topic is None else joints_of(topic, contents.path, warnings, decode)


def joints_of(topic: Topic, path: Path, warnings: list[DataWarning], decode: Decode) -> JointAngles:
    """Return the joint angles on a topic, in the order of the first message.

    Messages of a smaller device that share none of its joints, as of a gripper, are left out, with a warning.

    Raises
    ------
    RecordingError
        If the joints change, or it is not clear which are the robot's.
    """
    stamps, names, rows = decode(topic, path)
    of_robot, others = _robot_of(names)
    if others:
        text = f"left out {others} messages on {topic.name} with other joints than [{of_robot}]"
        warnings.append(DataWarning("joints", text))
    width = len(rows[names.index(of_robot)])
    joints = of_robot.split(", ")
    kept, found_rows = np.zeros(len(names), dtype=bool), []
    for k, (name, row) in enumerate(zip(names, rows, strict=True)):
        found = name.split(", ")
        if others and set(found).isdisjoint(joints):
            continue
        same = name == of_robot or (len(found) == width and sorted(set(found)) == sorted(joints))
        if not same or len(row) != width or len(row) == 0:
            raise RecordingError(
                f"message {k + 1} on {topic.name} has {len(row)} positions of the joints [{name}], expected "
                f"{width or 'some'} of [{of_robot}] as in the first; record one robot, always the same joints, on this "
                "topic",
                file=path,
            )
        kept[k] = True
        found_rows.append(row if name == of_robot else [row[found.index(joint)] for joint in joints])
    stamps, stamped = _stamps(stamps, topic, warnings)
    angles = np.array(found_rows, dtype=np.float64)[stamped[kept]]
    return JointAngles(stamps[kept & stamped], angles, _source(path, topic))


def _robot_of(names: Sequence[str]) -> tuple[str, int]:
    """Return the joints of the robot as they come first, and the number of messages that have none of them.

    Where a topic has messages of several devices that share no joint, the one with the most joints is the robot.
    """
    kinds = Counter(names)
    ranked = sorted(kinds, key=lambda name: -len(name.split(", ")))
    most = set(ranked[0].split(", "))
    apart = [name for name in ranked if most.isdisjoint(name.split(", "))]
    if any(len(name.split(", ")) == len(most) for name in apart):
        return names[0], 0
    return next(name for name in names if not most.isdisjoint(name.split(", "))), sum(kinds[name] for name in apart)

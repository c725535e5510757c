"""Which topics of a bag are used: by their names, by their types, and which of them are units of one tray."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from kreisel.errors import RecordingError, unknown_name
from kreisel.formats.topic_names import ENCODINGS, IMU, IMU_TOPIC, JOINT_TOPIC, JOINTS
from kreisel.recording.recording import DataWarning

if TYPE_CHECKING:
    from kreisel.formats.mcap import Contents, Topic

_OF_A_UNIT = re.compile(r"/imu(\d*)/data_raw")
_AFTER_A_LEAP = re.compile(r"(/imu\d*/data_raw)_(\d+)")
"""Topics that kreisel writes: readings of a unit, and those after its clock leapt."""


@dataclass(frozen=True)
class Role:
    """The use of a topic, the option that chooses it, and the topics that kreisel itself writes.

    Attributes
    ----------
    option
        Text before a topic's name where one is chosen.
    """

    what: str
    option: str
    msgtypes: frozenset[str]
    own: tuple[str, ...]


IMU_ROLE = Role("IMU readings", "--imu ", frozenset({IMU}), (IMU_TOPIC,))


def choose_topic(
    contents: Contents, role: Role, asked: str | None, warnings: list[DataWarning]
) -> tuple[Topic | None, str | None]:
    """Return the topic of `TOPIC` or `TOPIC@FRAME_ID`, and the frame id; no topic where the bag has none.

    Raises
    ------
    RecordingError
        If the choice is not clear, or the topic asked for is missing or holds something else.
    """
    fitting = _fitting(contents, role.msgtypes)
    of_imu = IMU in role.msgtypes
    name, frame = _split(asked, fitting, unit_topics(contents.topics, everything=True) if of_imu else {})
    own = tuple(unit_topics(contents.topics).values()) if of_imu else role.own
    return _choose(fitting, role, own, name, contents, warnings), frame


def unit_topics(topics: Iterable[Topic], *, everything: bool = False) -> dict[str, str]:
    """Return the topics with readings of IMUs by the names of the units: imu0, imu1, ….

    Parameters
    ----------
    everything
        Take all topics: those of kreisel keep their numbers, others have the next ones, in the order of their names.
        Otherwise kreisel's own, or the only one.
    """
    fitting = {t.name for t in topics if t.msgtype == IMU and t.encoding in ENCODINGS and t.count}
    names = sorted((name for name in fitting if not _is_later_part(name, fitting)), key=_in_natural_order)
    numbers = {name: int(found[1] or 0) for name in names if (found := _OF_A_UNIT.fullmatch(name))}
    if len(set(numbers.values())) < len(numbers):  # /imu/data_raw and /imu0/data_raw
        numbers = {name: k for k, name in enumerate(numbers)}
    if everything or (not numbers and len(names) == 1):
        others = [name for name in names if name not in numbers]
        numbers |= dict(zip(others, count(max(numbers.values(), default=-1) + 1), strict=False))
    return {f"imu{k}": name for name, k in sorted(numbers.items(), key=lambda item: item[1])}


def unit_of(topic: str, topics: Iterable[Topic]) -> str:
    """Return the name of the unit whose readings are on a topic: imu0 for those that are no unit."""
    units = unit_topics(topics, everything=True)
    return next((name for name, of_unit in units.items() if of_unit == topic), "imu0")


def _is_later_part(name: str, names: Iterable[str]) -> bool:
    later = _AFTER_A_LEAP.fullmatch(name)
    return later is not None and later[1] in names


def later_parts(topics: Iterable[Topic], name: str) -> list[Topic]:
    """Return the topics with the readings of a unit after its clock leapt, in their order; name: of its first topic."""
    found = [(_AFTER_A_LEAP.fullmatch(topic.name), topic) for topic in topics if topic.msgtype == IMU and topic.count]
    own = [(int(match[2]), topic) for match, topic in found if match is not None and match[1] == name]
    return [topic for _, topic in sorted(own, key=lambda one: one[0])]


def _in_natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key by which /b10 is after /b9."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def joint_topic(contents: Contents, reference: str | None, warnings: list[DataWarning]) -> Topic | None:
    """Return the topic with the robot's joint angles, on the same clock as the reference where kreisel wrote them."""
    topics = _fitting(contents, frozenset({JOINTS}))
    epoch = re.search(r"_\d+$", reference or "")
    own = f"{JOINT_TOPIC}{epoch[0]}" if epoch and JOINT_TOPIC in {topic.name for topic in topics} else JOINT_TOPIC
    chosen = [topic for topic in topics if topic.name == own] or topics
    if len(chosen) > 1:
        names = ", ".join(topic.name for topic in chosen)
        warnings.append(
            DataWarning("joints", f"left out, because {names} hold them; the robot's must be {JOINT_TOPIC}")
        )
    return chosen[0] if len(chosen) == 1 else None


def _fitting(contents: Contents, msgtypes: frozenset[str]) -> list[Topic]:
    topics = [topic for topic in contents.topics if topic.msgtype in msgtypes and topic.encoding in ENCODINGS]
    return [topic for topic in topics if topic.payloads]


def _split(asked: str | None, topics: list[Topic], units: Mapping[str, str]) -> tuple[str | None, str | None]:
    """Return topic and frame id of `TOPIC` or `TOPIC@FRAME_ID`; the leading slash may be left out, or a unit named."""
    if asked is None:
        return None, None
    name, at, frame = asked.partition("@")
    known = {topic.name for topic in topics}
    if name not in known and f"/{name}" in known:
        name = f"/{name}"
    return name if name in known else units.get(name, name), frame if at else None


def _choose(
    topics: list[Topic], role: Role, owns: tuple[str, ...], name: str | None, contents: Contents,
    warnings: list[DataWarning],
) -> Topic | None:  # fmt: skip
    path = contents.path
    if name is not None:
        named = [topic for topic in topics if topic.name == name]
        if not named:
            raise RecordingError(_not_found(name, topics, role, contents), file=path)
        return _only(named, role, path)
    for own in owns:
        named = [topic for topic in topics if topic.name == own]
        if named and len(topics) > len(named):
            others = ", ".join(topic.name for topic in topics)
            warnings.append(DataWarning("topics", f"took {own} of {others}; {role.option.strip()} chooses another"))
        if named:
            return _only(named, role, path)
    return _only(topics, role, path) if topics else None


def _only(topics: list[Topic], role: Role, path: Path) -> Topic:
    """Return the one topic, or raise the error that lists them all."""
    if len(topics) == 1:
        return topics[0]
    remedy = f"choose with {role.option}TOPIC"
    if role == IMU_ROLE:
        remedy += ", or take them all, as units of one rigid tray or array, with --imu all"
    if len({topic.name for topic in topics}) == 1:
        remedy = "they have the same name, so record them again under different names"
    raise RecordingError(f"{len(topics)} topics hold {role.what}, expected one: {listed(topics)}; {remedy}", file=path)


def listed(topics: Iterable[Topic]) -> str:
    """Return a text of topics and their contents, for a message."""
    return ", ".join(f"{t.name} ({t.msgtype or t.encoding}, {t.count} messages)" for t in topics)


def _not_found(name: str, topics: list[Topic], role: Role, contents: Contents) -> str:
    for topic in contents.topics:
        if topic.name == name:
            expected = ", ".join(sorted(role.msgtypes))
            return (
                f"the topic {name} holds {topic.count} messages of type {topic.msgtype or 'unknown'} "
                f"({topic.encoding}); expected {role.what}: {expected}. Choose with {role.option}TOPIC"
            )
    known = [topic.name for topic in topics] or [f"none: no topic holds {role.what}"]
    return f"{unknown_name(f'topic with {role.what}', name, known)}; choose with {role.option}TOPIC"

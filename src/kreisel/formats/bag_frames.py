"""Poses of one frame in another from the frames of a ROS system (`/tf` and `/tf_static` of a bag)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel.errors import RecordingError, unknown_name
from kreisel.formats.bag_messages import REFERENCE_ROWS, decode_frames
from kreisel.formats.topic_names import ENCODINGS, FRAMES
from kreisel.geometry.rotation import Array, apply, multiply
from kreisel.recording.recording import NO_REFERENCE, DataWarning, ReferencePoses, Stamps

if TYPE_CHECKING:
    from kreisel.formats.mcap import Contents, Topic

_STATIC = "tf_static"
"""How the names of topics with constant frames end."""

_TOGETHER = 0.9
"""Smallest share of a frame's stamps that the frames above it must have, too. Chosen: a recorder loses some
messages; frames of another source share next to none."""

_CHOICE = "'TOPIC@BASE:TOOL'"

_SHOWN = 12
"""Frames that a message lists."""


@dataclass(frozen=True)
class Frame:
    """A frame in its parent, at times: stamps (n,), ns, positions (n, 3), m, and quaternions (n, 4).

    A constant one has no stamps, and one row.
    """

    parent: str
    stamps_ns: Stamps
    positions: Array
    quaternions: Array

    @property
    def moves(self) -> bool:
        """Whether it changes."""
        return self.stamps_ns.size > 0

    def at(self, stamps_ns: Stamps) -> Frame:
        """Return it at some of its stamps; a constant one as it is."""
        if not self.moves:
            return self
        rows = np.searchsorted(self.stamps_ns, stamps_ns)
        return Frame(self.parent, stamps_ns, self.positions[rows], self.quaternions[rows])

    def carrying(self, child: Frame) -> Frame:
        """Return a frame in this one as a frame in the parent of this one."""
        stamps = self.stamps_ns if self.moves else child.stamps_ns
        positions = self.positions + apply(self.quaternions, child.positions)
        return Frame(self.parent, stamps, positions, multiply(self.quaternions, child.quaternions))


@dataclass(frozen=True)
class Poses:
    """Poses of a frame in another one, or in the one that all are in."""

    base: str
    tool: str
    motion: Frame


def frame_topics(contents: Contents, asked: str | None) -> list[Topic]:
    """Return the topics whose frames are the reference: the one asked for, or all where nothing else is one."""
    moving = [topic for topic in contents.topics if _holds_frames(topic)]
    if asked is not None:
        name = asked.partition("@")[0]
        return [topic for topic in moving if topic.name in (name, f"/{name}")][:1]
    others = any(topic.msgtype in REFERENCE_ROWS for topic in contents.topics if topic.count)
    return [] if others else moving


def frame_poses(contents: Contents, asked: str | None, warnings: list[DataWarning]) -> ReferencePoses | None:
    """Return poses of the frames in `TOPIC@BASE:TOOL`, or of the only one that moves and carries no other.

    Raises
    ------
    RecordingError
        If they were asked for, and are not there or not clear. Otherwise this is a warning.
    """
    try:
        topic, poses = _chosen(contents, asked)
    except RecordingError as error:
        if asked is not None:
            raise
        warnings.append(DataWarning(NO_REFERENCE, error.message))
        return None
    if "@" not in (asked or ""):
        text = f"took the frame '{poses.tool}' in '{poses.base}' on {topic.name}; --reference {_CHOICE} chooses others"
        warnings.append(DataWarning("topics", text.replace("TOPIC", topic.name)))
    found = poses.motion
    source = contents.path / topic.name.lstrip("/")
    return ReferencePoses(topic.name, found.stamps_ns, found.positions, found.quaternions, source)


def _chosen(contents: Contents, asked: str | None) -> tuple[Topic, Poses]:
    topics = frame_topics(contents, asked)
    trees = {topic.name: Tree(topic, contents.topics, contents.path) for topic in topics}
    base, _, tool = (asked or "").partition("@")[2].rpartition(":")
    if tool:
        return topics[0], trees[topics[0].name].poses(tool, base or None)
    ends = [(topic, tool) for topic in topics for tool in trees[topic.name].ends]
    found = [(topic, trees[topic.name].poses(tool)) for topic, tool in ends[:_SHOWN]]
    found = [(topic, poses) for topic, poses in found if np.ptp(poses.motion.positions, axis=0).any()]
    if len(found) != 1:
        names = ", ".join(f"{topic.name}@{poses.base}:{poses.tool}" for topic, poses in found) or "none"
        raise RecordingError(
            f"on {', '.join(trees)} one frame must change its place, and carry no others, to be the reference; these "
            f"do: {names}. Choose with --reference {_CHOICE}",
            file=contents.path,
        )
    return found[0]


def _holds_frames(topic: Topic) -> bool:
    """Return whether a topic's messages hold frames that may move."""
    return topic.msgtype in FRAMES and topic.encoding in ENCODINGS and topic.count > 0 and not _is_static(topic)


def _is_static(topic: Topic) -> bool:
    return topic.name.endswith(_STATIC)


class Tree:
    """The frames on one topic, together with all constant ones of a bag.

    Raises
    ------
    RecordingError
        If a message is damaged, or a frame has two parents.
    """

    def __init__(self, topic: Topic, topics: Iterable[Topic], path: Path) -> None:
        self._path, self._topic = path, topic.name
        self._frames: dict[str, Frame] = {}
        for one in topics:
            if one.msgtype in FRAMES and _is_static(one) and one.payloads:
                last = {child: (parent, row) for _, parent, child, row in decode_frames(one, path)}
                self._frames |= {child: _constant(parent, row) for child, (parent, row) in last.items()}
        rows: dict[str, list[tuple[int, tuple[float, ...]]]] = defaultdict(list)
        parents: dict[str, str] = {}
        for stamp, parent, child, row in decode_frames(topic, path):
            if parents.setdefault(child, parent) != parent:
                raise RecordingError(
                    f"the frame '{child}' on {topic.name} is in '{parents[child]}' and in '{parent}'; record one "
                    "system, its frames always in the same one",
                    file=path,
                )
            rows[child].append((stamp, row))
        self._frames |= {child: _frame(parents[child], found) for child, found in rows.items()}

    @property
    def ends(self) -> tuple[str, ...]:
        """The moving frames that carry no other moving one."""
        moving = [name for name, frame in self._frames.items() if frame.moves]
        carrying = {above for name in moving for above in self._way(name)[1:]}
        return tuple(sorted(name for name in moving if name not in carrying))

    def poses(self, tool: str, base: str | None = None) -> Poses:
        """Return the poses of a frame in another one; by default in the one at the root.

        Raises
        ------
        RecordingError
            If there is no such frame, no way up from it to the other, nothing moves, or frames are of different times.
        """
        if tool not in self._frames:
            known = sorted(self._frames)[:_SHOWN]
            raise RecordingError(unknown_name(f"frame on {self._topic}", tool, known), file=self._path)
        way = self._way(tool, base)
        root = self._frames[way[-1]].parent if way else tool
        if base not in (None, root):
            raise RecordingError(
                f"no frames on {self._topic} lead from '{tool}' up to '{base}', only to '{root}'; choose one of "
                f"{', '.join([*way[1:], root])}; constant frames come on /tf_static, record it, too",
                file=self._path,
            )
        links = [self._frames[name] for name in way]
        stamps = self._common(dict(zip(way, links, strict=True)), tool, root)
        motion = reduce(lambda child, link: link.at(stamps).carrying(child), links[1:], links[0].at(stamps))
        return Poses(root, tool, motion)

    def _way(self, frame: str, base: str | None = None) -> list[str]:
        """Return the frames from one up to the last before the base, or before the root."""
        way: list[str] = []
        while frame in self._frames and frame != base:
            if frame in way:
                raise RecordingError(
                    f"the frames {', '.join(way)} on {self._topic} carry each other; record one system", file=self._path
                )
            way.append(frame)
            frame = self._frames[frame].parent
        return way

    def _common(self, links: Mapping[str, Frame], tool: str, base: str) -> Stamps:
        """Return the stamps that all moving frames of a way have."""
        moving = {name: link.stamps_ns for name, link in links.items() if link.moves}
        if not moving:
            raise RecordingError(
                f"'{tool}' does not move in '{base}' on {self._topic}; choose other frames with --reference "
                f"{_CHOICE}. Moving ones are {', '.join(self.ends[:_SHOWN]) or 'none'}",
                file=self._path,
            )
        stamps = reduce(np.intersect1d, moving.values())
        fewest = min(moving, key=lambda name: moving[name].size)
        if stamps.size < _TOGETHER * moving[fewest].size:
            other = min(moving, key=lambda name: np.intersect1d(moving[fewest], moving[name]).size)
            raise RecordingError(
                f"the frames '{fewest}' and '{other}' between '{base}' and '{tool}' on {self._topic} are of different "
                f"times; choose base and tool whose frames come together, with --reference {_CHOICE}",
                file=self._path,
            )
        return stamps


def _constant(parent: str, row: Sequence[float]) -> Frame:
    values = np.array([row], dtype=np.float64)
    return Frame(parent, np.empty(0, dtype=np.int64), values[:, :3], values[:, 3:])


def _frame(parent: str, rows: Sequence[tuple[int, tuple[float, ...]]]) -> Frame:
    """Return a frame with rows in any order; of those with the same stamp the first counts, as in ROS."""
    values = np.array([row for _, row in rows], dtype=np.float64)
    if (values == values[0]).all():
        return _constant(parent, rows[0][1])
    stamps, first = np.unique(np.array([stamp for stamp, _ in rows], dtype=np.int64), return_index=True)
    return Frame(parent, stamps, values[first, :3], values[first, 3:])

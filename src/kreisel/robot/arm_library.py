"""Common arms by their link lengths, each with any tool: models/arms.csv."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import NamedTuple

import numpy as np

from kreisel.geometry.rotation import Array, matrix, roll_pitch_yaw

_JOINTS = 6  # of all arms in models/arms.csv
_AXIS = ("axis_x", "axis_y", "axis_z")


class Tool(NamedTuple):
    """The tool's frame on the flange: position, m, and rotation, a quaternion."""

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)


class _Joint(NamedTuple):
    """A joint at zero: its origin in the frame of the one before, m, its axis, limits, rad, and velocity, rad/s."""

    origin: tuple[float, ...]
    axis: tuple[float, ...]
    limits: tuple[float, float]
    velocity: float


@dataclass(frozen=True)
class LibraryArm:
    """An arm of six joints with a spherical wrist. At zero all frames have the base's directions.

    Attributes
    ----------
    name, title
        As in `robot.model` of recording.toml, and as its maker calls it.
    joints
        From the base on.
    flange : (3,)
        Its position in the last link's frame, m.
    flange_x : (3,)
        Direction of its x in the base's frame at zero; its z is along the base's x.
    """

    name: str
    title: str
    joints: tuple[_Joint, ...]
    flange: tuple[float, ...]
    flange_x: tuple[float, ...]

    @cached_property
    def _origins(self) -> Array:
        """Origins of the joints at zero, radius and height (6, 2), m."""
        return np.asarray(np.cumsum([joint.origin for joint in self.joints], axis=0)[:, [0, 2]])

    @property
    def shoulder(self) -> Array:
        """Axis 2 at zero: radius and height, m."""
        return np.asarray(self._origins[1])

    @property
    def elbow(self) -> Array:
        """Axis 3 at zero: radius and height, m."""
        return np.asarray(self._origins[2])

    @property
    def wrist(self) -> Array:
        """Wrist centre at zero: radius and height, m."""
        return np.asarray(self._origins[4])

    @property
    def flange_distance(self) -> float:
        """Distance of the flange from the wrist centre, m."""
        return float(self.joints[5].origin[0] + self.flange[0])

    def urdf(self, tool: Tool) -> str:
        """Return the arm's description (URDF) with a tool; its frame is the link "tool0"."""
        links = ['<link name="base_link"/>']
        for k, joint in enumerate(self.joints, 1):
            before = "base_link" if k == 1 else f"link_{k - 1}"
            links.append(
                f'<joint name="joint_{k}" type="revolute"><parent link="{before}"/><child link="link_{k}"/>'
                f'<origin xyz="{_words(joint.origin)}" rpy="0 0 0"/><axis xyz="{_words(joint.axis)}"/>'
                f'<limit lower="{joint.limits[0]:.9g}" upper="{joint.limits[1]:.9g}" velocity="{joint.velocity:.9g}" '
                f'effort="10000"/></joint><link name="link_{k}"/>'
            )
        x, z = np.array(self.flange_x), np.array([1.0, 0.0, 0.0])
        flange = np.column_stack([x, np.cross(z, x), z])
        C = flange @ matrix(np.array(tool.quaternion))
        position = np.array(self.flange) + flange @ np.array(tool.position)
        links.append(
            f'<joint name="tool" type="fixed"><parent link="link_{_JOINTS}"/><child link="tool0"/>'
            f'<origin xyz="{_words(position)}" rpy="{_words(roll_pitch_yaw(C))}"/></joint><link name="tool0"/>'
        )
        return f'<?xml version="1.0"?>\n<robot name="{self.name}">{"".join(links)}</robot>\n'


def _words(values: Iterable[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _library() -> dict[str, LibraryArm]:
    """Return the arms of models/arms.csv by name."""
    text = resources.files("kreisel.robot").joinpath("models", "arms.csv").read_text(encoding="utf-8")
    rows: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in csv.DictReader(line for line in text.splitlines() if not line.startswith("#")):
        rows.setdefault((row["name"], row["title"]), []).append(row)
    return {name: _arm(name, title, own) for (name, title), own in rows.items()}


def _arm(name: str, title: str, rows: list[dict[str, str]]) -> LibraryArm:
    def numbers(row: dict[str, str], *columns: str) -> tuple[float, ...]:
        return tuple(float(row[column]) for column in columns)

    *moving, flange = rows
    joints = tuple(
        _Joint(
            numbers(row, "x", "y", "z"), numbers(row, *_AXIS),
            (float(np.radians(float(row["lower"]))), float(np.radians(float(row["upper"])))),
            float(np.radians(float(row["velocity"]))),
        )
        for row in moving
    )  # fmt: skip
    return LibraryArm(name, title, joints, numbers(flange, "x", "y", "z"), numbers(flange, *_AXIS))


LIBRARY = _library()

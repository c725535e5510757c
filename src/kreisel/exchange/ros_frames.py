"""Where the units of a tray lie, for ROS: a URDF with fixed joints, and a launch file of static transforms.

Both place frame `imu` of each unit, in which `kreisel apply --axes imu` gives its rates and forces, in that of the
reference unit: x = R x_unit + position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kreisel.calibration.device_axes import AXES
from kreisel.errors import RecordingError
from kreisel.exchange.exported import ArrayRequest, ExportedArray, PlacedUnit
from kreisel.exchange.losses import clock_losses
from kreisel.geometry.rotation import Array, exp, from_matrix, matrix, multiply, roll_pitch_yaw

MAX_DIFFERENCE = 1e-9
"""Largest difference of a rotation's entries, and of a position in m, that is read back. Chosen: a nanometre on a
metre, far below any deviation; angles and quaternions keep the rotation to 1e-15."""


@dataclass(frozen=True)
class _Joint:
    """A unit's place as a file has it: frames, rotation (3, 3) and position (3,), m."""

    parent: str
    child: str
    rotation: Array
    position: Array


def export_urdf(request: ArrayRequest) -> ExportedArray:
    """Return a URDF with a link for each unit, fixed to that of the reference unit.

    Raises
    ------
    RecordingError
        If what is read back is another place.
    """
    robot = ElementTree.Element("robot", name="imus")
    base, others = request.units[0].unit, request.units[1:]
    for placed in request.units:
        ElementTree.SubElement(robot, "link", name=placed.unit.name)
    for placed in others:
        unit = placed.unit
        joint = ElementTree.SubElement(robot, "joint", name=f"{base.name}_to_{unit.name}", type="fixed")
        joint.append(_comment(_deviations(placed)))
        ElementTree.SubElement(joint, "parent", link=base.name)
        ElementTree.SubElement(joint, "child", link=unit.name)
        ElementTree.SubElement(
            joint, "origin", xyz=_numbers(unit.position), rpy=_numbers(roll_pitch_yaw(unit.rotation))
        )
    return _exported(request, robot, _joints_of_urdf)


def export_tf(request: ArrayRequest) -> ExportedArray:
    """Return a launch file of ROS 2 in XML that publishes a static transform for each unit.

    Raises
    ------
    RecordingError
        If what is read back is another place.
    """
    launch = ElementTree.Element("launch")
    base = request.units[0].unit
    for placed in request.units[1:]:
        unit = placed.unit
        w, x, y, z = from_matrix(unit.rotation)
        values = {
            **dict(zip("xyz", unit.position, strict=True)),
            **dict(zip(("qx", "qy", "qz", "qw"), (x, y, z, w), strict=True)),
        }
        options = " ".join(f"--{name} {float(value)!r}" for name, value in values.items())
        launch.append(_comment(_deviations(placed)))
        ElementTree.SubElement(
            launch,
            "node",
            pkg="tf2_ros",
            exec="static_transform_publisher",
            name=f"{base.name}_to_{unit.name}",
            args=f"{options} --frame-id {base.name} --child-frame-id {unit.name}",
        )
    return _exported(request, launch, _joints_of_launch)


def _exported(request: ArrayRequest, root: ElementTree.Element, read: Callable[[str], list[_Joint]]) -> ExportedArray:
    """Return the file of a document, read back and compared."""
    left_out = [f"left out: {name}: {reason}" for name, reason in request.left_out.items()]
    words = [f"{request.title}, by kreisel.", f"Frames: {AXES['imu']}.", *left_out]
    for k, line in enumerate(words):
        root.insert(k, _comment(line))
    ElementTree.indent(root)
    text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
    lost = [f"{placed.unit.name}: {text}" for placed in request.units for text in clock_losses(placed.unit.skew)]
    offsets = [f"{placed.unit.name}: the clock's offset: {placed.unit.offset:.9g} s" for placed in request.units[1:]]
    return ExportedArray({"": text}, ("errors of the sensors", *offsets, *lost), (_read_back(request, read(text)),))


def _read_back(request: ArrayRequest, joints: list[_Joint]) -> str:
    """Return how well the places in a file are those of the units.

    Raises
    ------
    RecordingError
        If they are not.
    """
    base, rotation, position = request.units[0].unit, 0.0, 0.0
    for placed, joint in zip(request.units[1:], joints, strict=True):
        unit = placed.unit
        if (joint.parent, joint.child) != (base.name, unit.name):
            raise RecordingError(f"{unit.name}: read back as {joint.child} on {joint.parent}")
        rotation = max(rotation, float(np.abs(joint.rotation - unit.rotation).max()))
        position = max(position, float(np.abs(joint.position - unit.position).max()))
    if not max(rotation, position) <= MAX_DIFFERENCE:
        raise RecordingError(
            f"places that are read back differ by {rotation:.1e} in a rotation and {position:.1e} m, expected "
            f"{MAX_DIFFERENCE:.0e} at most"
        )
    return (
        f"read back: rotations differ by {rotation:.1e}, positions by {position:.1e} m at most "
        f"(bound {MAX_DIFFERENCE:.0e})"
    )


def _joints_of_urdf(text: str) -> list[_Joint]:
    """Return the joints in a URDF, its angles about fixed axes x, y, z one after the other."""
    out = []
    for joint in ElementTree.fromstring(text).iter("joint"):
        place = {part.tag: part.attrib for part in joint if isinstance(part.tag, str)}
        roll, pitch, yaw = (float(word) for word in place["origin"]["rpy"].split())
        q = multiply(multiply(exp([0.0, 0.0, yaw]), exp([0.0, pitch, 0.0])), exp([roll, 0.0, 0.0]))
        position = np.array([float(word) for word in place["origin"]["xyz"].split()])
        out.append(_Joint(place["parent"]["link"], place["child"]["link"], matrix(q), position))
    return out


def _joints_of_launch(text: str) -> list[_Joint]:
    out = []
    for node in ElementTree.fromstring(text).iter("node"):
        words = node.attrib["args"].split()
        value = dict(zip(words[::2], words[1::2], strict=True))
        q = [float(value[f"--q{axis}"]) for axis in "wxyz"]
        position = np.array([float(value[f"--{axis}"]) for axis in "xyz"])
        out.append(_Joint(value["--frame-id"], value["--child-frame-id"], matrix(np.array(q)), position))
    return out


def _deviations(placed: PlacedUnit) -> str:
    unit = placed.unit
    return (
        f"{unit.name}: standard deviations in axes of the reference unit: position {_short(unit.position_sd)} m, "
        f"rotation {_short(unit.rotation_sd)} rad"
    )


def _short(values: Array) -> str:
    return f"[{', '.join(f'{x:.3g}' for x in values)}]"


def _numbers(values: Array | tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _comment(text: str) -> ElementTree.Element[Any]:
    """Return a comment of XML, which may not hold two hyphens."""
    return ElementTree.Comment(f" {' '.join(text.split()).replace('--', '- -')} ")

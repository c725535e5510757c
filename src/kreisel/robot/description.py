"""A serial arm read from its description (URDF): the joints between base and tool, and what hangs on each."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel._kernels.joint_chain import MAX_JOINTS, Chain
from kreisel.errors import RobotError, unknown_name
from kreisel.geometry.kuka import from_abc
from kreisel.geometry.rotation import Array, matrix
from kreisel.markup import screened

_ENDLESS, _USUAL_SPEED = 100.0, 3.0
"""rad and rad/s: range, and speed where none is stated, of joints that turn without end."""

_TURNING, _SLIDING, _SEVERAL = ("revolute", "continuous"), ("prismatic",), ("floating", "planar")
_KINDS = (*_TURNING, *_SLIDING, *_SEVERAL, "fixed")


@dataclass(frozen=True)
class Arm:
    """A serial arm from its base to the tool centre point.

    Attributes
    ----------
    name, joints
        Names of the robot and of the joints that move the tool, from the base on.
    tcp
        Name of the tool's frame.
    urdf
        The description it was read from.
    lower, upper, velocity : (n,)
        Limits of the joints, rad and rad/s.
    chain
        The arm as the library takes it.
    """

    name: str
    joints: tuple[str, ...]
    tcp: str
    urdf: str
    lower: Array
    upper: Array
    velocity: Array
    chain: Chain


@dataclass(frozen=True)
class _Joint:
    """A joint of the description; `limits` are lower, upper and velocity, of joints with one angle."""

    name: str
    kind: str
    parent: str
    child: str
    C: Array
    p: Array
    axis: Array
    limits: tuple[float, float, float]

    @property
    def moves(self) -> bool:
        return self.kind != "fixed"


@dataclass(frozen=True)
class _Body:
    """Mass, kg, and centre (3,) in the link's frame, m."""

    mass: float
    centre: Array


class _FaultError(ValueError):
    """Something in the description that cannot be; becomes a RobotError that names the file."""


def parse_arm(urdf: str, tcp: str | None = None, source: str = "robot.urdf") -> Arm:
    """Return the arm that a URDF's text describes; `source` is named in messages.

    Meshes are not read. Joints that do not move the tool stand at zero; links on them move with the link before.

    Raises
    ------
    RobotError
        If it cannot be read, has no such frame, or no joint moves the tool.
    """
    try:
        root = ElementTree.fromstring(screened(urdf))
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotError(f"{source}: not XML: {error}; expected a robot's description (URDF)") from error
    try:
        bodies, joints = _bodies(root), [_joint(element) for element in root.findall("joint")]
        above, order = _tree(bodies, joints)
    except _FaultError as error:
        raise RobotError(f"{source}: not a robot description (URDF): {error}") from error
    tcp = _tool(above, order) if tcp is None else tcp
    if tcp not in order:
        raise RobotError(f"{source}: {unknown_name('frame', tcp, order)}")
    path = _path(above, tcp)
    moving = [joint for joint in path if joint.moves]
    if not moving:
        raise RobotError(f"{source}: no joint moves '{tcp}'; name the tool's frame, one of {', '.join(order)}")
    if several := [joint for joint in moving if joint.kind in _SEVERAL]:
        kind = several[0].kind
        raise RobotError(f"{source}: each joint must have one angle; {several[0].name}, which moves {tcp}, is {kind}")
    if len(moving) > MAX_JOINTS:
        raise RobotError(f"{source}: {len(moving)} joints move '{tcp}'; expected {MAX_JOINTS} at most")
    lower, upper, velocity = np.array([joint.limits for joint in moving]).T.copy()
    names = tuple(joint.name for joint in moving)
    chain = _chain(path, _carried(bodies, above, order, moving))
    return Arm(root.get("name") or "", names, tcp, urdf, lower, upper, velocity, chain)


# The elements of the file


def _bodies(root: ElementTree.Element) -> dict[str, _Body]:
    """Return the links by name."""
    if root.tag != "robot":
        raise _FaultError(f"its element is <{root.tag}>, expected <robot>")
    bodies: dict[str, _Body] = {}
    for link in root.findall("link"):
        name = _named(link, "name", "a link")
        if name in bodies:
            raise _FaultError(f"two links are named '{name}'")
        bodies[name] = _body(link, name)
    if not bodies:
        raise _FaultError("it has no <link>")
    return bodies


def _body(link: ElementTree.Element, name: str) -> _Body:
    inertial = link.find("inertial")
    if inertial is None:
        return _Body(0.0, np.zeros(3))
    mass = inertial.find("mass")
    if mass is None:
        raise _FaultError(f"link '{name}': <inertial> without <mass>")
    value = _numbers(mass.get("value", ""), 1, f"the mass of link '{name}'")[0]
    if value < 0.0:
        raise _FaultError(f"the mass of link '{name}' is {value:g} kg, expected zero or more")
    return _Body(value, _origin(inertial, f"the mass of link '{name}'")[1])


def _joint(element: ElementTree.Element) -> _Joint:
    name = _named(element, "name", "a joint")
    where = f"joint '{name}'"
    kind = element.get("type", "")
    if kind not in _KINDS:
        raise _FaultError(f"{where} is of type '{kind}', expected one of {', '.join(_KINDS)}")
    ends = []
    for role in ("parent", "child"):
        end = element.find(role)
        if end is None:
            raise _FaultError(f"{where} has no <{role}>")
        ends.append(_named(end, "link", f"the {role} of {where}"))
    C, p = _origin(element, where)
    axis, limits = np.array([1.0, 0.0, 0.0]), (0.0, 0.0, 0.0)
    if kind in (*_TURNING, *_SLIDING):
        stated = element.find("axis")
        if stated is not None:
            axis = _numbers(stated.get("xyz", "1 0 0"), 3, f"the axis of {where}")
        if not (length := float(np.linalg.norm(axis))) > 0.0:
            raise _FaultError(f"the axis of {where} is zero")
        axis, limits = axis / length, _limits(element, kind, where)
    return _Joint(name, kind, ends[0], ends[1], C, p, axis, limits)


def _limits(element: ElementTree.Element, kind: str, where: str) -> tuple[float, float, float]:
    """Return lower and upper limit and velocity; joints without end have wide ones."""
    limit = element.find("limit")
    endless = kind == "continuous"
    if limit is None and not endless:
        raise _FaultError(f"{where} is {kind} and has no <limit>; state lower, upper and velocity")
    stated = {} if limit is None else limit.attrib

    def number(key: str, default: str) -> float:
        return float(_numbers(stated.get(key, default), 1, f"{key} of the limit of {where}")[0])

    if "velocity" not in stated and not endless:
        raise _FaultError(f"the limit of {where} has no velocity")
    velocity = number("velocity", f"{_USUAL_SPEED}")
    if endless:
        return -_ENDLESS, _ENDLESS, velocity
    return number("lower", "0"), number("upper", "0"), velocity


def _named(element: ElementTree.Element, key: str, what: str) -> str:
    name = element.get(key)
    if not name:
        raise _FaultError(f"{what} has no {key}")
    return name


def _origin(element: ElementTree.Element, where: str) -> tuple[Array, Array]:
    """Return rotation matrix and position of an element's <origin>; the identity without one."""
    origin = element.find("origin")
    stated = {} if origin is None else origin.attrib
    p = _numbers(stated.get("xyz", "0 0 0"), 3, f"the position of {where}")
    roll, pitch, yaw = _numbers(stated.get("rpy", "0 0 0"), 3, f"the angles of {where}").tolist()
    return matrix(from_abc(yaw, pitch, roll)), p


def _numbers(text: str, count: int, what: str) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise _FaultError(f"{what} is '{text[:60]}', expected {'a number' if count == 1 else f'{count} numbers'}")
    return values


# The tree of links


def _tree(bodies: dict[str, _Body], joints: Sequence[_Joint]) -> tuple[dict[str, _Joint], list[str]]:
    """Return the joint above each link, and the links from the base on, each branch whole, by names of joints."""
    above: dict[str, _Joint] = {}
    below: dict[str, list[_Joint]] = {name: [] for name in bodies}
    seen: set[str] = set()
    for joint in joints:
        if joint.name in seen:
            raise _FaultError(f"two joints are named '{joint.name}'")
        seen.add(joint.name)
        for end in (joint.parent, joint.child):
            if end not in bodies:
                raise _FaultError(f"joint '{joint.name}' names the link '{end}', which does not exist")
        if joint.child in above:
            raise _FaultError(f"two joints carry the link '{joint.child}': {above[joint.child].name}, {joint.name}")
        above[joint.child] = joint
        below[joint.parent].append(joint)
    bases = [name for name in bodies if name not in above]
    if len(bases) != 1:
        raise _FaultError(f"{len(bases)} links hang on no joint ({', '.join(bases[:5])}), expected one, the base")
    order, waiting = [], list(bases)
    while waiting:
        order.append(waiting.pop())
        own = sorted(below[order[-1]], key=lambda joint: joint.name, reverse=True)
        waiting += [joint.child for joint in own]
    if len(order) < len(bodies):
        raise _FaultError(f"links carry each other in a circle: {', '.join(sorted(set(bodies) - set(order))[:5])}")
    return above, order


def _path(above: dict[str, _Joint], link: str) -> list[_Joint]:
    """Return the joints from the base to a link."""
    path = []
    while link in above:
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def _tool(above: dict[str, _Joint], order: Sequence[str]) -> str:
    """Return the last link of those that most joints move."""
    depth: dict[str, int] = {}
    for link in order:
        depth[link] = depth[above[link].parent] + above[link].moves if link in above else 0
    most = max(depth.values())
    return [link for link in order if depth[link] == most][-1]


def _carried(
    bodies: dict[str, _Body], above: dict[str, _Joint], order: Sequence[str], moving: Sequence[_Joint]
) -> Array:
    """Return mass and centre of all that each joint carries as far as the next, (joints, 4); the others stand at zero.

    What stands on the base is carried by none.
    """
    number = {joint.name: k for k, joint in enumerate(moving)}
    holder: dict[str, tuple[int, Array, Array]] = {order[0]: (-1, np.eye(3), np.zeros(3))}
    mass, moment = np.zeros(len(moving)), np.zeros((len(moving), 3))
    for link in order:
        if link in above:
            joint = above[link]
            k, C, p = holder[joint.parent]
            here = (k, C @ joint.C, p + C @ joint.p)
            holder[link] = (number[joint.name], np.eye(3), np.zeros(3)) if joint.name in number else here
        k, C, p = holder[link]
        if k >= 0:
            mass[k] += bodies[link].mass
            moment[k] += bodies[link].mass * (p + C @ bodies[link].centre)
    return np.column_stack([mass, moment / np.where(mass > 0.0, mass, 1.0)[:, None]])


def _chain(path: Sequence[_Joint], carried: Array) -> Chain:
    """Return the chain; fixed joints become part of the next placement."""
    rotations, translations = [], []
    C, p = np.eye(3), np.zeros(3)
    for joint in path:
        C, p = C @ joint.C, p + C @ joint.p
        if joint.moves:
            rotations.append(C.ravel())
            translations.append(p)
            C, p = np.eye(3), np.zeros(3)
    moving = [joint for joint in path if joint.moves]
    return Chain(
        rotations=np.array([*rotations, C.ravel()]),
        translations=np.array([*translations, p]),
        axes=np.array([joint.axis for joint in moving]),
        turning=np.array([joint.kind in _TURNING for joint in moving]),
        bodies=carried,
    )

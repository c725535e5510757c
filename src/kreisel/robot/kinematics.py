"""Pose and motion of an arm's tool for given joint angles; its description is read by pinocchio."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kreisel._kernels import chain
from kreisel.errors import RobotError, unknown_name
from kreisel.files import read_text
from kreisel.geometry.rotation import Array, matrix
from kreisel.markup import screened

MODELS = ("kr125", "ur10e")
"""Arms that come with kreisel."""

STANDARD_GRAVITY = 9.81
"""m/s^2, for torques."""

_ATTEMPTS = 16
"""Number of start values of the inverse: the given joint angles, then others drawn from the ranges."""


@dataclass(frozen=True)
class Arm:
    """A serial arm from its base to the tool centre point.

    Attributes
    ----------
    name, joints
        Names of the robot and of the joints that move the tool, from the base on.
    urdf
        The description it was read from.
    lower, upper, velocity : (n,)
        Limits of the joints, rad and rad/s.
    model, frame
        pinocchio's, of only this chain.
    """

    name: str
    joints: tuple[str, ...]
    urdf: str
    lower: Array
    upper: Array
    velocity: Array
    model: Any
    frame: int

    @cached_property
    def chain(self) -> chain.Chain:
        """The arm as the library takes it."""
        pin = pinocchio()
        model, data, joints = self.model, self.model.createData(), self.model.nv
        placements = [*list(model.jointPlacements)[1:], model.frames[self.frame].placement]
        pin.computeJointJacobians(model, data, pin.neutral(model))
        own = [pin.getJointJacobian(model, data, j + 1, pin.LOCAL).reshape(6, joints)[:, j] for j in range(joints)]
        turning = np.array([np.linalg.norm(subspace[3:]) > 0.5 for subspace in own])
        bodies = list(model.inertias)[1:]
        return chain.Chain(
            rotations=np.array([placement.rotation.ravel() for placement in placements]),
            translations=np.array([placement.translation for placement in placements]),
            axes=np.array([s[3:] if turns else s[:3] for s, turns in zip(own, turning, strict=True)]),
            turning=turning,
            bodies=np.array([[body.mass, *body.lever] for body in bodies]),
        )

    @property
    def tcp(self) -> str:
        """Name of the tool's frame."""
        return str(self.model.frames[self.frame].name)


@dataclass(frozen=True)
class ToolMotion:
    """Motion of the tool, one row for each moment.

    Attributes
    ----------
    positions, velocities, accelerations : (n, 3)
        In the base's frame.
    quaternions : (n, 4)
        q_rb, without jumps of sign.
    rates, angular_accelerations : (n, 3)
        Against the base, in the tool's frame.
    """

    positions: Array
    quaternions: Array
    velocities: Array
    accelerations: Array
    rates: Array
    angular_accelerations: Array


def pinocchio() -> Any:
    """Return the library, or raise an error that says how to install it."""
    try:
        import pinocchio as pin
    except ImportError as error:
        raise RobotError("robot kinematics need pinocchio: pip install 'kreisel[robot]'") from error
    return pin


def load_arm(source: str | Path, tcp: str | None = None) -> Arm:
    """Return an arm from a URDF file, or one of `MODELS` by name; meshes are not read.

    Parameters
    ----------
    tcp
        Frame of the tool; the last link by default.

    Raises
    ------
    RobotError
        If it cannot be read, has no such frame, or no joint moves the tool.
    """
    if str(source) in MODELS:
        text = resources.files("kreisel.robot").joinpath("models", f"{source}.urdf").read_text(encoding="utf-8")
        return parse_arm(text, tcp, str(source))
    path = Path(source)
    if path.suffix.lower() not in (".urdf", ".xml"):
        raise RobotError(f"{unknown_name('robot', str(source), MODELS)}; or give a .urdf file")
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise RobotError(f"{path}: cannot be read: {reason}; expected a robot's description (URDF)") from error
    return parse_arm(text, tcp, str(path))


def parse_arm(urdf: str, tcp: str | None = None, source: str = "robot.urdf") -> Arm:
    """Return an arm from the text of a URDF; see `load_arm`. `source` is named in messages."""
    pin = pinocchio()
    try:
        model = pin.buildModelFromXML(_plain(urdf, source))
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"{source}: not a robot description pinocchio can read: {error}") from error
    frames = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
    if tcp is None:
        depth = {name: len(_chain(model, model.getFrameId(name, pin.FrameType.BODY))) for name in frames}
        tcp = [name for name in frames if depth[name] == max(depth.values())][-1] if frames else ""
    if tcp not in frames:
        raise RobotError(f"{source}: {unknown_name('frame', tcp, frames)}")
    moving = _chain(model, model.getFrameId(tcp, pin.FrameType.BODY))
    if not moving:
        raise RobotError(f"{source}: no joint moves '{tcp}'; name the tool's frame, one of {', '.join(frames)}")
    others = [j for j in range(1, model.njoints) if j not in moving]
    model = pin.buildReducedModel(model, others, pin.neutral(model))
    if model.nq != model.nv:
        raise RobotError(f"{source}: each joint must have one angle; {tcp} is attached to others")
    names = tuple(model.names[1:])
    lower, upper = (np.array(limit, dtype=float) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    return Arm(
        str(model.name),
        names,
        urdf,
        lower,
        upper,
        np.array(model.velocityLimit),
        model,
        model.getFrameId(tcp, pin.FrameType.BODY),
    )


def _plain(urdf: str, source: str) -> str:
    """Return the description without meshes, with (wide) limits for its joints of unlimited range."""
    try:
        root = ElementTree.fromstring(screened(urdf))
    except (ElementTree.ParseError, ValueError) as error:
        raise RobotError(f"{source}: not XML: {error}; expected a robot's description (URDF)") from error
    for link in root.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", "-100.0")
            limit.set("upper", "100.0")
            limit.set("velocity", limit.get("velocity", "3.0"))
            limit.set("effort", limit.get("effort", "1000"))
    return ElementTree.tostring(root, encoding="unicode")


def _chain(model: Any, frame: int) -> list[int]:
    """Return the joints from the base to a frame."""
    joint = model.frames[frame].parentJoint
    return [int(j) for j in model.supports[joint]][1:]


def poses(arm: Arm, angles: Array) -> tuple[Array, Array]:
    """Return positions (n, 3) and quaternions (n, 4) of the tool for joint angles (n, joints)."""
    still = np.zeros_like(angles, dtype=float)
    q, p, *_ = chain.motion(arm.chain, angles, still, still)
    return p, q


def skeleton(arm: Arm, angles: Array) -> Array:
    """Return the positions of base, joints and tool for one set of joint angles, (joints + 2, 3), in the base frame."""
    pin = pinocchio()
    model, data = arm.model, arm.model.createData()
    pin.forwardKinematics(model, data, np.ascontiguousarray(angles, dtype=float))
    tool = pin.updateFramePlacement(model, data, arm.frame).translation
    return np.vstack([np.zeros(3), *(placement.translation for placement in data.oMi[1:]), tool])


def motion(arm: Arm, angles: Array, rates: Array, accelerations: Array) -> ToolMotion:
    """Return the tool's motion for joint angles, rates and accelerations, (n, joints) each."""
    q, p, v, a, omega, alpha = chain.motion(arm.chain, angles, rates, accelerations)
    return ToolMotion(p, q, v, a, omega, alpha)


class Derivatives(NamedTuple):
    """How a tool's pose changes at n sets of joint angles, and what holds the arm there.

    Attributes
    ----------
    regressor : (n, 6, 6 (joints + 1))
        The pose differentiated by small errors of the placements. An error of joint i is a small motion (position, then
        rotation) of its placement in the frame of the link before, in coordinates of the placement itself; the last six
        are the same for the tool on the last link. Rows: position in the base's frame, rotation as a right perturbation
        (in the tool's frame).
    jacobian : (n, 6, joints)
        The pose differentiated by the joint angles; rows likewise.
    torques : (n, joints)
        That hold the arm against gravity, N m.
    """

    regressor: Array
    jacobian: Array
    torques: Array


def derivatives(arm: Arm, angles: Array) -> Derivatives:
    """Return how the tool's pose changes at joint angles (n, joints)."""
    return Derivatives(*chain.derivatives(arm.chain, angles, STANDARD_GRAVITY))


def gravity_torques(arm: Arm, angles: Array) -> Array:
    """Return the torques that hold the arm against gravity, (n, joints), N m."""
    return derivatives(arm, angles).torques


def with_placement_errors(arm: Arm, errors: Array) -> Arm:
    """Return the arm with the placements of joints and tool moved by errors (joints + 1, 6); see `regressor`."""
    pin = pinocchio()
    model = pin.Model(arm.model)
    steps = [pin.exp6(pin.Motion(error[:3], error[3:])) for error in errors]
    for j, step in enumerate(steps[:-1], start=1):
        model.jointPlacements[j] = model.jointPlacements[j] * step
    model.frames[arm.frame].placement = model.frames[arm.frame].placement * steps[-1]
    return replace(arm, model=model)


def inverse(arm: Arm, position: Array, quaternion: Array, start: Array) -> Array:
    """Return joint angles (joints,) that bring the tool to a pose, within the ranges, near `start` if possible.

    Raises
    ------
    RobotError
        If none are found; the message says how near the arm comes, or which joint is beyond its range.
    """
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    nearest, beyond = np.inf, None
    for attempt in range(_ATTEMPTS):
        q, error, apart = _approach(arm, position, quaternion, start if attempt == 0 else rng.uniform(low, high))
        nearest = min(nearest, apart)
        if error >= 1e-6:
            continue
        q = _within(q, arm.lower, arm.upper)
        try:
            check_range(arm, q)
        except RobotError as problem:
            beyond = beyond or problem
            continue
        return q
    if beyond is not None:
        raise beyond
    raise RobotError(f"out of reach: the arm comes no nearer than {nearest:.3f} m")


def _approach(arm: Arm, position: Array, quaternion: Array, start: Array) -> tuple[Array, float, float]:
    """Return the angles reached from `start` by damped least squares, the remaining error, and the distance, m."""
    pin = pinocchio()
    model, data, frame = arm.model, arm.model.createData(), arm.frame
    target = pin.SE3(matrix(quaternion), np.asarray(position, dtype=float))
    q = np.array(start, dtype=float)
    error = np.full(6, np.inf)
    for _ in range(300):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        error = pin.log6(data.oMf[frame].actInv(target)).vector
        if np.linalg.norm(error) < 1e-10:
            break
        damping = 1e-6 + 0.01 * min(float(error @ error), 1.0)
        step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
        q = q + step * min(1.0, 0.3 / max(float(np.max(np.abs(step))), 1e-12))
    apart = float(np.linalg.norm(np.asarray(data.oMf[frame].translation) - position))
    return q, float(np.linalg.norm(error)), apart


def _within(q: Array, lower: Array, upper: Array) -> Array:
    """Return angles moved by full turns into their limits where that is possible."""
    turned = q - 2.0 * np.pi * np.round(q / (2.0 * np.pi))
    return np.where((q >= lower) & (q <= upper), q, turned)


def check_range(arm: Arm, angles: Sequence[float] | Array) -> None:
    """Raise RobotError if an angle is beyond its joint's limit; name joint and limit."""
    if len(angles) != len(arm.joints):
        raise RobotError(f"{len(angles)} joint angles, expected {len(arm.joints)}: {', '.join(arm.joints)}")
    for name, angle, low, high in zip(arm.joints, angles, arm.lower, arm.upper, strict=True):
        if not low - 1e-9 <= angle <= high + 1e-9:
            raise RobotError(
                f"{name} at {np.degrees(angle):.2f} deg is beyond its range, {np.degrees(low):.1f} to "
                f"{np.degrees(high):.1f} deg"
            )

"""Pose and motion of an arm's tool for given joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kreisel._kernels import chain
from kreisel.errors import RobotError, unknown_name
from kreisel.files import read_text
from kreisel.geometry.pose import exp_motion, log_motion
from kreisel.geometry.rotation import Array, exp, matrix
from kreisel.robot.arm_library import LIBRARY, Tool
from kreisel.robot.description import Arm, parse_arm
from kreisel.units import STANDARD_GRAVITY

MODELS = ("kr125", "ur10e")
"""Arms whose masses are described too."""

_ATTEMPTS = 16
"""Number of start values of the inverse: the given joint angles, then others drawn from the ranges."""


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


def load_arm(source: str | Path, tcp: str | None = None) -> Arm:
    """Return an arm from a URDF file, or one of `MODELS` or of the library by name; meshes are not read.

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
    if str(source) in LIBRARY:
        return parse_arm(LIBRARY[str(source)].urdf(Tool()), tcp, str(source))
    path = Path(source)
    if path.suffix.lower() not in (".urdf", ".xml"):
        raise RobotError(f"{unknown_name('robot', str(source), (*MODELS, *LIBRARY))}; or give a .urdf file")
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise RobotError(f"{path}: cannot be read: {reason}; expected a robot's description (URDF)") from error
    return parse_arm(text, tcp, str(path))


def poses(arm: Arm, angles: Array) -> tuple[Array, Array]:
    """Return positions (n, 3) and quaternions (n, 4) of the tool for joint angles (n, joints)."""
    still = np.zeros_like(angles, dtype=float)
    q, p, *_ = chain.motion(arm.chain, angles, still, still)
    return p, q


def skeleton(arm: Arm, angles: Array) -> Array:
    """Return the positions of base, joints and tool for one set of joint angles, (joints + 2, 3), in the base frame."""
    own = arm.chain
    C, p = np.eye(3), np.zeros(3)
    points = [p]
    for k, angle in enumerate(angles):
        C, p = C @ own.rotations[k].reshape(3, 3), p + C @ own.translations[k]
        if own.turning[k]:
            C = C @ matrix(exp(angle * own.axes[k]))
        else:
            p = p + C @ (angle * own.axes[k])
        points.append(p)
    return np.array([*points, p + C @ own.translations[-1]])


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
    rotations, translations = arm.chain.rotations.copy(), arm.chain.translations.copy()
    for k, error in enumerate(errors):
        C, (turn, shift) = rotations[k].reshape(3, 3), exp_motion(error)
        translations[k] += C @ shift
        rotations[k] = (C @ turn).ravel()
    return replace(arm, chain=arm.chain._replace(rotations=rotations, translations=translations))


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
    target = matrix(quaternion)
    q = np.array(start, dtype=float)
    error, p = np.full(6, np.inf), np.full(3, np.inf)
    for _ in range(300):
        there, attitude = poses(arm, q[None])
        p, C = there[0], matrix(attitude[0])
        error = log_motion(C.T @ target, C.T @ (position - p))
        if np.linalg.norm(error) < 1e-10:
            break
        J = derivatives(arm, q[None]).jacobian[0]
        J[:3] = C.T @ J[:3]  # in the tool's axes, as the error
        damping = 1e-6 + 0.01 * min(float(error @ error), 1.0)
        step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
        q = q + step * min(1.0, 0.3 / max(float(np.max(np.abs(step))), 1e-12))
    return q, float(np.linalg.norm(error)), float(np.linalg.norm(p - position))


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

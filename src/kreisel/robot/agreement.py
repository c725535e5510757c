"""Check that the poses a controller reports are those of a model at the reported joint angles, up to base and tool.

The reported pose is base * model * tool, with base and tool constant and unknown. Between two poses of the arm the
motion of the tool is then the model's in other coordinates: the angle of its rotation, and the shift along the axis of
that rotation, are the same. One pose alone determines only the tool for an assumed base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kreisel.geometry.rotation import Array, conjugate, lengths, log, matrix, multiply
from kreisel.robot import kinematics
from kreisel.robot.description import Arm

ANGLE = math.radians(1.5)
"""rad; rotations of model and controller that differ by more are those of different robots."""

SHIFT = 0.025
"""m; the same for shifts: a controller's own calibration changes its poses by centimetres at most."""

APART = math.radians(2.0)
"""rad; poses are compared once a joint has turned by this angle."""

SLOW = 0.5
"""rad/s; poses of a faster arm are not compared: angles and pose may be of different moments."""

_TURNS = (0.2, 2.9)  # rad; range of rotation angles for which the axis is well defined
_MAX_POSES = 60
"""Poses that a new one is compared with; the first of all is kept. Chosen: poses come up to 500 times a second, and
each comparison must be short against the interval."""

_AGAIN = 2  # poses in a row that must disagree


class Reported(Protocol):
    """Report of a controller at a moment: stamp (ns), joint angles (rad), position (m) and attitude of its tool."""

    @property
    def stamp_ns(self) -> int:
        """Stamp, ns."""
        ...

    @property
    def joints(self) -> tuple[float, ...]:
        """Joint angles, rad."""
        ...

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Position of the tool, m."""
        ...

    @property
    def quaternion(self) -> tuple[float, float, float, float] | None:
        """Attitude of the tool, scalar first."""
        ...


@dataclass(frozen=True)
class Tool:
    """The tool that explains one reported pose, for the better of two bases: the model's, or it turned 180 deg about z.

    Attributes
    ----------
    length, angle
        Of the tool, m and rad.
    turned
        Whether the base is rotated.
    """

    length: float
    angle: float
    turned: bool


def tool_of(arm: Arm, sample: Reported) -> Tool | None:
    """Return the tool that explains a reported pose; None where the robot does not report position and attitude."""
    if sample.position is None or sample.quaternion is None:
        return None
    (p,), (q,) = kinematics.poses(arm, np.array([sample.joints]))
    found = []
    for turned, q_base in ((False, np.array([1.0, 0, 0, 0])), (True, np.array([0.0, 0, 0, 1.0]))):
        C_base = matrix(q_base[None])[0]
        apart = C_base.T @ np.array(sample.position) - p
        turn = multiply(conjugate(multiply(q_base[None], q[None])), np.array([sample.quaternion]))
        found.append(Tool(float(np.linalg.norm(apart)), float(np.linalg.norm(log(turn)[0])), turned))
    return min(found, key=lambda tool: tool.length)


class Agreement:
    """Comparison of poses while an arm moves.

    Attributes
    ----------
    complaint
        Message that says how model and controller disagree, or None.
    turned
        Largest rotation between two poses that were compared, rad.
    """

    def __init__(self, arm: Arm) -> None:
        self.complaint: str | None = None
        self.turned = 0.0
        self._arm = arm
        self._before: Reported | None = None
        self._taken: list[Reported] = []
        self._model: list[tuple[Array, Array]] = []
        self._wrong = 0

    def take(self, sample: Reported) -> None:
        """Compare a pose with earlier ones, if the arm is slow and has moved since."""
        before, self._before = self._before, sample
        if before is None or sample.position is None or sample.quaternion is None or self.complaint is not None:
            return
        if _rate(before, sample) > SLOW or (self._taken and _apart(self._taken[-1], sample) < APART):
            return
        (p,), (q,) = kinematics.poses(self._arm, np.array([sample.joints]))
        wrong = self._compare(sample, p, q)
        self._wrong = self._wrong + 1 if wrong else 0
        if self._wrong >= _AGAIN:
            self.complaint = wrong
        self._taken.append(sample)
        self._model.append((p, q))
        if len(self._taken) > _MAX_POSES:
            del self._taken[1], self._model[1]

    def _compare(self, sample: Reported, p: Array, q: Array) -> str | None:
        if not self._taken:
            return None
        p_all, q_all = (np.array(part) for part in zip(*self._model, strict=True))
        angle_model, shift_model = _motions(p_all, q_all, p, q)
        p_seen, q_seen = (np.array([getattr(one, name) for one in self._taken]) for name in ("position", "quaternion"))
        angle, shift = _motions(p_seen, q_seen, np.array(sample.position), np.array(sample.quaternion))
        self.turned = max(self.turned, float(angle_model.max()))
        inside = (np.minimum(angle, angle_model) > _TURNS[0]) & (np.maximum(angle, angle_model) < _TURNS[1])
        off = np.where(inside, np.abs(shift - shift_model), 0.0)
        share = np.maximum(np.abs(angle - angle_model) / ANGLE, off / SHIFT)
        k = int(np.argmax(share))
        if share[k] <= 1.0:
            return None
        return (
            f"the poses that the controller reports do not follow the model '{self._arm.name}': between two poses the "
            f"tool turned by {math.degrees(angle[k]):.1f} deg and shifted by {1e3 * shift[k]:.0f} mm along that axis, "
            f"the model by {math.degrees(angle_model[k]):.1f} deg and {1e3 * shift_model[k]:.0f} mm; is it another "
            "robot? Give its description with --model"
        )


def _motions(p_before: Array, q_before: Array, p: Array, q: Array) -> tuple[Array, Array]:
    """Return angles (n,), rad, and shifts along the axes (n,), m, of the motions from n poses to another one."""
    theta = log(multiply(conjugate(q_before), np.broadcast_to(q, q_before.shape)))
    angle = lengths(theta)
    t = np.einsum("nji,nj->ni", matrix(q_before), p - p_before)
    return angle, np.einsum("ni,ni->n", theta, t) / np.maximum(angle, 1e-12)


def _apart(a: Reported, b: Reported) -> float:
    return max(abs(x - y) for x, y in zip(a.joints, b.joints, strict=True))


def _rate(a: Reported, b: Reported) -> float:
    seconds = (b.stamp_ns - a.stamp_ns) * 1e-9
    return _apart(a, b) / seconds if seconds > 0.0 else math.inf

"""Which arm reported the poses, where they show it: one whose axes 2 and 3 stand still while the tool turns.

The wrist centre then stays at one radius and one height. Where it lies in the tool's frame, and these two figures,
follow from the poses alone; an arm of the library fits if its axes 2 and 3 then stand at whole angles, as in programs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask, conjugate, from_two_vectors, lengths, log, matrix, multiply
from kreisel.robot.arm_library import LIBRARY, LibraryArm, Tool

_STILL = 3e-4
"""m; how far the wrist centre of an arm may move from one pose to the next while axes 2 and 3 stand still."""

_TURN, _SHIFT = 0.2, 0.1
"""rad and m; motion of the tool from one compared pose to the next."""

_MIN_SHARE, _MIN_POSES, _MOST = 0.5, 30, 500
"""Share of the motion in which it must stand still, and smallest and largest number of poses that are compared."""

_MIN_INFORMATION = 0.05
"""Smallest eigenvalue of the normal equations of the wrist centre: two turns about different axes give more."""

_WHOLE, _NEAR = np.radians(5.0), np.radians(0.03)
"""rad; programs put axes at multiples of the one, and poses show them within the other."""

_ALONG_AN_AXIS = 2e-3
"""rad; a straight tool whose frame has the directions of the flange's."""

_REACHES, _ROUNDS = (0.15, -0.15, 0.35, -0.35), 60
"""m, places of the wrist centre in the tool's frame to start from, and the largest number of rounds from each."""


@dataclass(frozen=True)
class Identified:
    """An arm of the library and its tool, and what shows them.

    Attributes
    ----------
    arm, tool
        The arm, and the tool's frame on its flange.
    wrist : (2,)
        Radius and height of the wrist centre, m.
    share
        Of the motion in which axes 2 and 3 stand still.
    """

    arm: LibraryArm
    tool: Tool
    wrist: Array
    share: float


@dataclass(frozen=True)
class Wrist:
    """The wrist centre of an arm, as poses show it.

    Attributes
    ----------
    place : (3,)
        In the tool's frame, m.
    radius, height : (k,)
        About and along the base's z, at some of the poses, m.
    still : (k,)
        Where these did not change.
    information
        Smallest eigenvalue of the normal equations of the place.
    """

    place: Array
    radius: Array
    height: Array
    still: Mask
    information: float

    @property
    def share(self) -> float:
        """Share of the motion in which it stands still."""
        return float(np.mean(self.still))


def identified(wrist: Wrist) -> tuple[Identified, ...]:
    """Return the arms of the library, each with a straight tool, that fit a wrist centre that stands still."""
    places = np.column_stack([wrist.radius, wrist.height])[wrist.still]
    found = []
    for arm in LIBRARY.values():
        tool = straight_tool(arm, wrist)
        if tool is not None and _at_whole_angles(arm, places):
            found.append(Identified(arm, tool, np.median(places, axis=0), wrist.share))
    return tuple(found)


def steady_wrist(positions: Array, quaternions: Array) -> Wrist | None:
    """Return the wrist centre of the arm that moves the tool through poses (m, 3), (m, 4) in the base's frame.

    It is the point of the tool whose radius and height change least, in the sum of absolute changes. None where it does
    not stand still most of the time, or the tool turns about one direction only.

    Notes
    -----
    Gauss-Newton with weights for a sum of absolute values (iteratively reweighted least squares), from several places.
    """
    which = _apart(positions, quaternions)
    if which.size < _MIN_POSES:
        return None
    p, C = positions[which], matrix(quaternions[which])
    starts = [np.zeros(3), *(reach * axis for reach in _REACHES for axis in np.eye(3))]
    wrist = min((_descent(p, C, start) for start in starts), key=lambda one: one[0])[1]
    return wrist if wrist.share >= _MIN_SHARE and wrist.information >= _MIN_INFORMATION else None


def _apart(positions: Array, quaternions: Array) -> Indices:
    """Return poses between which the tool has moved a little: those of a standstill count once."""
    moved = lengths(np.diff(positions, axis=0)) / _SHIFT
    moved += lengths(log(multiply(conjugate(quaternions[:-1]), quaternions[1:]))) / _TURN
    along = np.concatenate([[0.0], np.cumsum(moved)])
    return np.unique(np.searchsorted(along, np.arange(0.0, along[-1], max(1.0, along[-1] / _MOST))))


def _descent(p: Array, C: Array, place: Array) -> tuple[float, Wrist]:
    for _ in range(_ROUNDS):
        W = p + C @ place
        radius = np.maximum(np.hypot(W[:, 0], W[:, 1]), 1e-9)
        by_radius = (W[:, :1] * C[:, 0] + W[:, 1:2] * C[:, 1]) / radius[:, None]
        change = np.concatenate([np.diff(radius), np.diff(W[:, 2])])
        J = np.vstack([np.diff(by_radius, axis=0), np.diff(C[:, 2], axis=0)])
        weighted = J / np.maximum(np.abs(change), 0.3 * _STILL)[:, None]
        H = weighted.T @ J
        step = np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(3), weighted.T @ change)
        place = place - step
        if np.abs(step).max() < 1e-7:
            break
    moved = np.abs(change).reshape(2, -1)
    still = (moved < _STILL).all(axis=0)
    wrist = Wrist(place, radius[1:], W[1:, 2], still, float(np.linalg.eigvalsh(J.T @ J)[0]))
    return float(moved.sum()), wrist


def straight_tool(arm: LibraryArm, wrist: Wrist) -> Tool | None:
    """Return the tool along the flange's axis that the wrist centre's place shows, or None if it is another."""
    reach = float(np.linalg.norm(wrist.place))
    length = reach - arm.flange_distance
    if length < -_STILL:
        return None
    toward = wrist.place / reach
    if np.arccos(min(1.0, float(np.abs(toward).max()))) > _ALONG_AN_AXIS:
        return None
    nearest = np.zeros(3)
    nearest[np.argmax(np.abs(toward))] = np.sign(toward[np.argmax(np.abs(toward))])
    # the wrist lies against the flange's z
    return Tool((0.0, 0.0, max(length, 0.0)), tuple(from_two_vectors(nearest, np.array([0.0, 0.0, -1.0])).tolist()))


def _at_whole_angles(arm: LibraryArm, places: Array) -> bool:
    """Return whether axes 2 and 3 of an arm stand at whole angles with its wrist centre at radii and heights (k, 2)."""
    shoulder, upper, fore = arm.shoulder, arm.elbow - arm.shoulder, arm.wrist - arm.elbow
    a, b = float(np.linalg.norm(upper)), float(np.linalg.norm(fore))
    for side in (1.0, -1.0):
        to = places * [side, 1.0] - shoulder
        distance = lengths(to)
        cosine = (a**2 + distance**2 - b**2) / (2.0 * a * distance)
        if np.abs(cosine).max() > 1.0:
            continue
        toward = np.arctan2(to[:, 1], to[:, 0])
        for elbow in (1.0, -1.0):
            first = toward + elbow * np.arccos(cosine)
            rest = to - a * np.column_stack([np.cos(first), np.sin(first)])
            second = np.arctan2(rest[:, 1], rest[:, 0])
            angles = np.column_stack([
                first - np.arctan2(upper[1], upper[0]),
                second - np.arctan2(fore[1], fore[0]),
            ])  # fmt: skip
            off = np.abs(angles - _WHOLE * np.round(angles / _WHOLE)).max(axis=1)
            if np.mean(off < _NEAR) > 0.9:
                return True
    return False

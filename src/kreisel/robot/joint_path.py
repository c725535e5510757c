"""Joint angles along a path of reported poses: a controller computes poses by its model, so they give the angles back.

A pose of an arm of six joints has up to eight solutions, and near singular postures they meet. The path is followed
from each solution of the first pose, pose by pose where the tool has moved a little. Of the paths along which the
joints move about as evenly as possible, the one nearest to the middle of their ranges is taken. The poses between start
from there and are solved together.
"""

from __future__ import annotations

import numpy as np

from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array, Indices, conjugate, lengths, log, multiply
from kreisel.robot import kinematics
from kreisel.robot.description import Arm

EXACT, REACHED = 1e-6, 1e-3
"""m and rad; distance of a solution, and of the nearest posture of a stretched arm: poses have noise."""

_TURN, _SHIFT, _FAST, _MOST = 0.1, 0.05, 0.95, 8000
"""rad and m; motion of the tool between two followed poses, in which share of the time; largest number of them."""

_STEPS, _FEW_STEPS, _STEP = 30, 8, 0.3
"""Largest number of steps for a pose, and from near it; largest change of an angle by one, rad."""

_DRAWS, _SAME = 40, 1e-3
"""Start values for the first pose, and how near two solutions are the same, rad."""

_KEPT, _DEAR = 12, 1e3
"""Number of paths that are followed at once, and what an angle outside its range costs, rad."""

_ALIKE = 1.05
"""Factor on the least unevenness up to which paths are alike; arms rarely work over their heads."""

_AT_ONCE = 5000
"""Poses solved together, for the memory they take."""

_MARGIN = 0.05
"""rad; how far beyond its range a joint may be: ranges can be extended by options."""

_OTHERWISE = "is it another arm, base or tool?"


def joint_path(arm: Arm, positions: Array, quaternions: Array) -> Array:
    """Return the joint angles (m, joints), rad, that bring the tool to poses (m, 3), (m, 4) in the base's frame.

    Raises
    ------
    RobotError
        If the arm does not reach a pose, or poses do not determine its joints.
    """
    if len(arm.joints) > 6:
        raise RobotError(
            f"{arm.name} has {len(arm.joints)} joints; poses alone determine six at most: record the angles"
        )
    which = _knots(positions, quaternions)
    starts = _starts(arm, positions[0], quaternions[0])
    if not starts.size:
        raise RobotError(f"{arm.name} does not reach the first pose; {_OTHERWISE}")
    followed = _follow(arm, positions[which], quaternions[which], starts)
    start = np.column_stack([np.interp(np.arange(len(positions)), which, column) for column in followed.T])
    angles, distance = np.empty_like(start), np.empty(len(start))
    for begin in range(0, len(start), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        angles[part], distance[part] = _solve(arm, positions[part], quaternions[part], start[part])
    for k in np.flatnonzero(distance > REACHED).tolist():  # between knots on both sides of a singular posture
        here = slice(k, k + 1)
        angles[here], distance[here] = _solve(arm, positions[here], quaternions[here], angles[max(k - 1, 0)][None])
    if distance.max() > REACHED:
        raise RobotError(f"{arm.name} does not reach pose {int(np.argmax(distance))}; {_OTHERWISE}")
    return angles


def _knots(positions: Array, quaternions: Array) -> Indices:
    """Return the poses to follow, evenly in time: the tool moves a little from one to the next, even when fast."""
    moved = lengths(np.diff(positions, axis=0)) / _SHIFT
    moved += lengths(log(multiply(conjugate(quaternions[:-1]), quaternions[1:]))) / _TURN
    fast, last = float(np.quantile(moved, _FAST)), len(positions) - 1
    stride = max(1, int(1.0 / max(fast, 1e-9)), last // _MOST)
    return np.unique([*range(0, last, min(stride, last)), last])


def _starts(arm: Arm, position: Array, quaternion: Array) -> Array:
    """Return the solutions of one pose within the joints' ranges, (s, joints)."""
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    drawn = np.vstack([0.5 * (low + high), rng.uniform(low, high, size=(_DRAWS, len(low)))])
    everywhere = np.ones((len(drawn), 1))
    angles, distance = _solve(arm, everywhere * position, everywhere * quaternion, drawn)
    turned = angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi))
    angles = np.where(arm.chain.turning, turned, angles)[distance < EXACT]
    found = np.zeros((0, len(low)))
    for own in angles:
        if _outside(arm, own[None])[0] <= _MARGIN and np.all(np.abs(found - own).max(axis=1) > _SAME):
            found = np.vstack([found, own])
    return found


def _follow(arm: Arm, positions: Array, quaternions: Array, starts: Array) -> Array:
    """Return the angles along a path (m, joints) that begins at one of several solutions of its first pose.

    Where two solutions meet, the joints may go on or turn back. Both are followed, and those kept along which the
    joints have moved most evenly.

    Raises
    ------
    RobotError
        If no path reaches the last pose.
    """
    here, ahead, cost = starts, starts, np.zeros(len(starts))
    paths, parents = [starts], [np.zeros(0, dtype=np.int64)]
    for k in range(1, len(positions)):
        each = np.ones((2 * len(here), 1))
        angles, distance = _solve(arm, each * positions[k], each * quaternions[k], np.vstack([ahead, here]), _FEW_STEPS)
        parent = np.tile(np.arange(len(here)), 2)
        costs = cost[parent] + np.abs(angles - ahead[parent]).sum(axis=1)
        costs += np.where(_outside(arm, angles) > _MARGIN, _DEAR, 0.0)
        kept: list[int] = []
        for i in np.argsort(costs):
            apart = np.abs(angles[kept] - angles[i]).max(axis=1, initial=0.0)
            if distance[i] <= REACHED and (apart > _SAME).all() and len(kept) < _KEPT:
                kept.append(int(i))
        if not kept:
            raise RobotError(f"{arm.name} does not reach the reported poses in one posture; {_OTHERWISE}")
        ahead = 2.0 * angles[kept] - here[parent[kept]]
        here, cost = angles[kept], costs[kept]
        paths.append(here)
        parents.append(parent[kept])
    found = [_traced(paths, parents, i) for i in np.flatnonzero(cost <= _ALIKE * cost.min()).tolist()]
    middle, range_ = 0.5 * (arm.lower + arm.upper), np.maximum(arm.upper - arm.lower, _SAME)
    return min(found, key=lambda angles: float((np.abs(angles - middle) / range_).sum()))


def _traced(paths: list[Array], parents: list[Indices], last: int) -> Array:
    """Return the path that ends with one of the last solutions, (m, joints)."""
    out, at = np.empty((len(paths), paths[0].shape[1])), int(last)
    for k in range(len(paths) - 1, -1, -1):
        out[k] = paths[k][at]
        at = int(parents[k][at]) if k else 0
    return out


def _outside(arm: Arm, angles: Array) -> Array:
    """Return how far angles (m, joints) are outside of their ranges at most, (m,); negative inside."""
    return np.asarray(np.max(np.maximum(arm.lower - angles, angles - arm.upper), axis=1))


def _solve(arm: Arm, positions: Array, quaternions: Array, start: Array, steps: int = _STEPS) -> tuple[Array, Array]:
    """Return angles (m, joints) near start values that bring the tool to poses, and the remaining distances (m,).

    Notes
    -----
    Damped least squares (Nakamura and Hanafusa 1986); the damping goes with the distance.
    """
    angles = np.array(start, dtype=float)
    open_ = np.arange(len(angles))
    distance = np.full(len(angles), np.inf)
    for _ in range(steps):
        p, q = kinematics.poses(arm, angles[open_])
        error = np.hstack([positions[open_] - p, log(multiply(conjugate(q), quaternions[open_]))])
        distance[open_] = lengths(error)
        going = distance[open_] > 1e-3 * EXACT
        open_, error = open_[going], error[going]
        if open_.size == 0:
            break
        J = kinematics.derivatives(arm, angles[open_]).jacobian
        damping = 1e-9 + 1e-3 * np.minimum(distance[open_], 1.0) ** 2
        H = J.transpose(0, 2, 1) @ J + damping[:, None, None] * np.eye(J.shape[2])
        step = np.linalg.solve(H, np.einsum("kij,ki->kj", J, error)[..., None])[..., 0]
        angles[open_] += step * np.minimum(1.0, _STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    return angles, distance

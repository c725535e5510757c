"""The measurement model of the cell: the pose the reference should show, and the velocity at standstill."""

from __future__ import annotations

import numpy as np

from kreisel._kernels import composition, manifold, rotation
from kreisel._kernels.arrays import Array, Mask, PreparedReadings
from kreisel._kernels.blocks import column_of, place, rows_from
from kreisel._kernels.cell import (
    AT_POSITION,
    ATTITUDE,
    JITTER_POSITION,
    PATH_ORIENTATION,
    PATH_POSITION,
    POSITION,
    STAMP,
    STANDSTILL_ORIENTATION,
    STANDSTILL_POSITION,
    STANDSTILL_VELOCITY,
    VELOCITY,
    IntegratedMotion,
    Model,
    Moments,
    Steps,
)
from kreisel._kernels.compilation import kernel, part_of_kernel


@part_of_kernel
def measurement_noise(model: Model, at_standstill: bool, given: Mask, velocity: Array, omega: Array) -> Array:
    """Return the factor (m, m + 1) of the measurement noise; the last column is that of the stamps.

    given (2,): see `cell.Steps`; velocity (3,) and omega (3,) at the update.
    """
    m = 3 * (given[0] + given[1] + at_standstill)
    out = np.zeros((m, m + 1))
    at = 0
    for kind in range(2):
        if given[kind]:
            for axis in range(3):
                out[at + axis, at + axis] = model.noise[(JITTER_POSITION if at_standstill else AT_POSITION) + kind]
                if not at_standstill:
                    out[at + axis, m] = model.noise[STAMP] * (velocity[axis] if kind == 0 else omega[axis])
            at += 3
    if at_standstill:
        for axis in range(3):
            out[at + axis, at + axis] = model.noise[STANDSTILL_VELOCITY]
    return out


@kernel
def predict_poses(
    model: Model, motion: IntegratedMotion, regressor: Array, at_standstill: bool, moments: Moments, points: Array
) -> tuple[Array, Array]:
    """Return attitude (4, m) and position (3, m) the reference should show at given moments: equation (13).

    regressor (6, e): that of the robot's errors; points (size, m): the states at the last sample.
    """
    at, m = model.stored, points.shape[1]
    q, p = np.empty((4, m)), np.empty((3, m))
    composition.pose_at(
        moments, motion, rows_from(points, at[ATTITUDE], 4), rows_from(points, at[VELOCITY], 3),
        rows_from(points, at[POSITION], 3), q, p,
    )  # fmt: skip
    of_position = at[STANDSTILL_POSITION if at_standstill else PATH_POSITION]
    of_attitude = at[STANDSTILL_ORIENTATION if at_standstill else PATH_ORIENTATION]
    if of_position >= 0:
        for axis in range(3):
            for s in range(m):
                p[axis, s] += points[of_position + axis, s]
    if of_attitude >= 0:
        rotation.plus(q, rows_from(points, of_attitude, 3), q)
    if regressor.shape[1] == 0:
        return q, p
    # equation (13): the reported pose is the nominal arm's: the tool's own, less what the arm's errors add to it.
    turned, source, known = np.zeros((3, m)), model.robot.source, model.robot.known
    for axis in range(3):
        for e in range(source.size):
            row, moves, turns = source[e], regressor[axis, e], regressor[3 + axis, e]
            if row >= 0:
                for s in range(m):
                    p[axis, s] -= moves * points[row, s]
                    turned[axis, s] -= turns * points[row, s]
            elif known[e] != 0.0:
                for s in range(m):
                    p[axis, s] -= moves * known[e]
                    turned[axis, s] -= turns * known[e]
    rotation.plus(q, turned, q)
    return q, p


@part_of_kernel
def predict_measurement(
    model: Model, signal: PreparedReadings, steps: Steps, i: int, motion: IntegratedMotion, points: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Return what points (size, 2 n + 1) predict for update i, and its measurement: distances from the centre's.

    Three arrays: predictions (m, 2 n + 1) of the points; predictions (m, 2 k) of the centre with columns of noise
    (c, k) added, all in plus, then all in minus; the measurement (m,).
    """
    stamps, start, skew, tau = signal.stamps, motion.around[7], motion.around[8], steps.tau[i]
    sigma, last, at_standstill = points.shape[1], steps.last[i], steps.at_standstill[i]
    others = disturbed(model, column_of(points, 0), noise)
    t, t_centre = np.empty(sigma), np.empty(1)
    for s in range(sigma):
        t[s] = start[s] + (1.0 + skew[s]) * tau - stamps[last]  # equation (11)
    t_centre[0] = t[0]
    before, after = stamps[last] - stamps[last - 1], stamps[last + 1] - stamps[last]
    same = np.zeros(others.shape[1], dtype=np.int64)
    regressor = steps.regressor[i]
    own, centre = Moments(t, before, after, model.which, np.arange(sigma)), Moments(t_centre, before, after, same, same)
    q, p = predict_poses(model, motion, regressor, at_standstill, own, points)
    q_others, p_others = predict_poses(model, motion, regressor, at_standstill, centre, others)
    m = 3 * (steps.given[0] + steps.given[1] + at_standstill)
    seen, seen_others, measured = np.empty((m, sigma)), np.empty((m, others.shape[1])), np.empty((m, 1))
    row = 0
    if steps.given[0]:
        for axis in range(3):
            measured[axis, 0] = steps.position[i, axis] - p[axis, 0]
        distances(p, 0, p, 0, seen, 0)
        distances(p_others, 0, p, 0, seen_others, 0)
        row = 3
    if steps.given[1]:
        q_centre, quaternion = np.empty((4, 1)), np.empty((4, 1))
        for j in range(4):
            q_centre[j, 0] = q[j, 0]
            quaternion[j, 0] = steps.quaternion[i, j]
        rotation.minus(q, q_centre, rows_from(seen, row, 3))
        rotation.minus(q_others, q_centre, rows_from(seen_others, row, 3))
        rotation.minus(quaternion, q_centre, rows_from(measured, row, 3))
        row += 3
    if at_standstill:
        at = model.stored[VELOCITY]
        for axis in range(3):
            measured[row + axis, 0] = -points[at + axis, 0]  # equation (14)
        distances(points, at, points, at, seen, row)
        distances(others, at, points, at, seen_others, row)
    return seen, seen_others, column_of(measured, 0)


@part_of_kernel
def disturbed(model: Model, centre: Array, noise: Array) -> Array:
    """Return the centre (size,) with columns of noise (c, k) added, (size, 2 k): all in plus, then in minus."""
    c, k = noise.shape
    last = model.parts.shape[0] - 1
    n = model.parts[last, manifold.DEGREE] + model.parts[last, manifold.DEGREES]
    change = np.zeros((n, 2 * k))
    place(noise, n - c, 0, change)
    for i in range(c):
        for j in range(k):
            change[n - c + i, k + j] = -noise[i, j]
    out = np.empty((centre.size, 2 * k))
    manifold.plus(model.parts, centre, change, out)
    return out


@kernel
def distances(points: Array, at: int, centre: Array, centre_at: int, out: Array, row: int) -> None:
    """Write three rows of points (r, m), less those of the first column of centre (s, k), into out (R, m).

    The rows begin at `at` in points, at `centre_at` in centre, and at `row` in out.
    """
    for axis in range(3):
        for s in range(points.shape[1]):
            out[row + axis, s] = points[at + axis, s] - centre[centre_at + axis, 0]

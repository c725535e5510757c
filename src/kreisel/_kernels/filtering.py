"""The filter over many updates without leaving compiled code: sigma points, motion, measurement, update.

What is general about the filter stands in `sigma_points`; what is known of the cell, in a `Model`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kreisel._kernels import (
    coefficients,
    composition,
    manifold,
    preintegration,
    rotation,
    sensor_noise,
    sigma_points,
    triangular,
)
from kreisel._kernels.blocks import column_of, place, rows_from
from kreisel._kernels.compilation import kernel, part_of_kernel
from kreisel._kernels.quadrature import POINTS

VELOCITY, POSITION, ATTITUDE, REST_POSITION, REST_ORIENTATION, PATH_POSITION, PATH_ORIENTATION = range(7)
"""Places of parts in `Model.stored`."""

AT_POSITION, AT_ORIENTATION, JITTER_POSITION, JITTER_ORIENTATION, STANDSTILL, STAMP = range(6)
"""Places of figures in `Model.noise`: reference on the path and at rest, velocity at rest, stamps."""

MEASURED = 9
"""Most numbers a measurement has: position, orientation, velocity."""


class Rows(NamedTuple):
    """Where some numbers of the model come from: rows of the stored state, or, where -1, known values."""

    source: np.ndarray
    known: np.ndarray


class Model(NamedTuple):
    """What a cell's filter needs to know besides state, readings and poses.

    Attributes
    ----------
    parts, tail : (p, 4), (t, 4)
        Tables of `manifold` for the state, and for its last parts alone, which change between updates.
    weights : (5,)
        See `sigma_points.SPREAD`.
    gyro, accel, around, robot : Rows
        Sensor parameters; alignment, north, gravity, time offset and skew, Earth rate downward; errors of the robot.
    turning, sharing : (a,), (b,)
        Sigma points with gyro parameters of their own, the centre first, and with accelerometer parameters.
    which : (2 n + 1,)
        For every sigma point its column among these.
    stored : (7,)
        Where parts lie in the stored state, -1 where they are not in it.
    order, products, inside
        Of the sensor model; see `coefficients.force_coefficients`.
    level, down
        Earth rate that a unit of north, and of its downward part, stands for, rad/s.
    noise : (6,)
        Standard deviations; see `AT_POSITION`.
    lasting : (3,)
        How long the reference's errors last, s, and their deviations in position and orientation.
    walking, walk : (w,)
        Degrees of freedom that walk, and their densities.
    noise_step
        Seconds of readings whose noise is taken together.
    """

    parts: np.ndarray
    tail: np.ndarray
    weights: np.ndarray
    gyro: Rows
    accel: Rows
    around: Rows
    robot: Rows
    turning: np.ndarray
    sharing: np.ndarray
    which: np.ndarray
    stored: np.ndarray
    order: int
    products: float
    inside: bool
    level: float
    down: float
    noise: np.ndarray
    lasting: np.ndarray
    walking: np.ndarray
    walk: np.ndarray
    noise_step: float


class Steps(NamedTuple):
    """Updates in their order: samples, reference seconds, pose, regressor of the robot's errors.

    first, last, tau, resting (u,); position (u, 3), quaternion (u, 4), of which `given` (2,) says whether
    they are measured; regressor (u, 6, e), with e = 0 without a robot.
    """

    first: np.ndarray
    last: np.ndarray
    tau: np.ndarray
    resting: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    given: np.ndarray
    regressor: np.ndarray


class Record(NamedTuple):
    """What updates leave: see `calibration.filter_run.History`.

    mean (u, size), deviation (u, n), used (u,); innovation and whitened (u, 9), their factor and the
    noise's covariance (u, 9, 9), gain of velocity and attitude (u, 6, 9). Of the nines the first m count.
    """

    mean: np.ndarray
    deviation: np.ndarray
    used: np.ndarray
    innovation: np.ndarray
    whitened: np.ndarray
    factor: np.ndarray
    noise: np.ndarray
    gain: np.ndarray


@kernel
def rows_of(rows, points, columns):
    """Return some numbers of the model for some sigma points, (e, m)."""
    out = np.empty((rows.source.size, columns.size))
    composition.gather(points, columns, rows.source, rows.known, out)
    return out


@kernel
def sensor_coefficients(model, points, rate, force, shared):
    """Write the coefficients of `preintegration` for the sigma points."""
    order, turning, sharing = model.order, model.turning.size, model.sharing.size
    gyro = rows_of(model.gyro, points, model.turning)
    coefficients.rate_coefficients(gyro[:9].reshape(3, 3, turning), gyro[9:].reshape(order, 3, turning), rate)
    alone = np.empty((rate.shape[0], 3, 1))
    for f in range(rate.shape[0]):
        for row in range(3):
            alone[f, row, 0] = rate[f, row, 0]
    own, others = rows_of(model.accel, points, model.turning), rows_of(model.accel, points, model.sharing)
    at = 9 + 3 * order
    coefficients.force_coefficients(
        rate, own[:9].reshape(3, 3, turning), own[9:at].reshape(order, 3, turning), own[at:].reshape(3, 3, turning),
        model.products, model.inside, force,
    )  # fmt: skip
    coefficients.force_coefficients(
        alone, others[:9].reshape(3, 3, sharing), others[9:at].reshape(order, 3, sharing),
        others[at:].reshape(3, 3, sharing), model.products, model.inside, shared,
    )  # fmt: skip


@part_of_kernel
def measurement_noise(model, resting, given, velocity, omega):
    """Return the factor (m, m + 1) of the measurement noise; the last column is that of the stamps."""
    m = 3 * (given[0] + given[1] + resting)
    out = np.zeros((m, m + 1))
    at = 0
    for kind in range(2):
        if given[kind]:
            for axis in range(3):
                out[at + axis, at + axis] = model.noise[(JITTER_POSITION if resting else AT_POSITION) + kind]
                if not resting:
                    out[at + axis, m] = model.noise[STAMP] * (velocity[axis] if kind == 0 else omega[axis])
            at += 3
    if resting:
        for axis in range(3):
            out[at + axis, at + axis] = model.noise[STANDSTILL]
    return out


class Motion(NamedTuple):
    """The motion to an update: what carries sigma points on to the reference's own time, and its noise.

    Columns of omega, alpha (3, M) and force (3, 3, M) are those of `Model.which`; q_first, gravity and earth_rate
    have one for each sigma point. noise (9, 9): factor of noise in velocity, position and attitude.
    """

    q_first: np.ndarray
    omega: np.ndarray
    alpha: np.ndarray
    force: np.ndarray
    gravity: np.ndarray
    earth_rate: np.ndarray
    around: np.ndarray
    noise: np.ndarray


@part_of_kernel
def propagate(model, signal, first, last, points):
    """Carry sigma points from sample `first` to `last`, in place, and return the `Motion`."""
    at = model.stored
    turning, sharing, sigma = model.turning.size, model.sharing.size, points.shape[1]
    P, M = 1 + 3 * model.order, turning + sharing
    features = coefficients.force_features(P, model.order)
    rate = np.empty((P, 3, turning))
    force, shared = np.empty((features, 3, turning)), np.empty((features, 3, sharing))
    sensor_coefficients(model, points, rate, force, shared)
    low, high = min(signal.base[first], last - 1), max(last, signal.base[last - 1] + POINTS - 1)
    dq, dv, dp = np.empty((4, M)), np.empty((3, M)), np.empty((3, M))
    omega, alpha, u_end = np.empty((3, M)), np.empty((3, M)), np.empty((3, 3, M))
    u_path, q_path = np.empty((high - low + 1, 3)), np.empty((high - low + 1, 4))
    preintegration.preintegrate(
        first, last, low, high, signal, rate, force, shared, dq, dv, dp, omega, alpha, u_end, u_path, q_path
    )
    q, v, p = rows_from(points, at[ATTITUDE], 4), rows_from(points, at[VELOCITY], 3), rows_from(points, at[POSITION], 3)
    q_first = np.empty((4, sigma))
    place(q, 0, 0, q_first)
    around = rows_of(model.around, points, np.arange(sigma))
    gravity, earth_rate = np.empty((3, sigma)), np.empty((3, sigma))
    composition.environment(model.level, model.down, around[:4], around[4:6], around[9], around[6], gravity, earth_rate)
    duration = signal.stamps[last] - signal.stamps[first]
    composition.compose(duration, model.which, dq, dv, dp, gravity, earth_rate, q, v, p)

    taken = max(1, int(model.noise_step * (last - first) / duration)) if duration > 0.0 else 1
    K_omega, K_a = np.empty((3, 3)), np.empty((3, 3))
    for row in range(3):
        for axis in range(3):
            K_omega[row, axis] = rate[1 + axis, row, 0]
            K_a[row, axis] = force[P * (P + 1) // 2 + P - 1 + axis, row, 0]
    Q, noise = np.empty((9, 9)), np.empty((9, 9))
    sensor_noise.noise_covariance(first, last, low, taken, signal, u_path, q_path, K_omega, K_a, Q)
    sensor_noise.navigation_noise(Q, column_of(q_first, 0), column_of(dq, 0), noise)
    return Motion(q_first, omega, alpha, u_end, gravity, earth_rate, around, noise)


@part_of_kernel
def process_noise(model, navigation, duration, points):
    """Return noise columns (c, k) of all that changes, and let lasting errors of the reference (points) fade."""
    at, lasting = model.stored, 0
    for name in (PATH_POSITION, PATH_ORIENTATION):
        lasting += 3 if at[name] >= 0 else 0
    out = np.zeros((lasting + 9, lasting + 9))
    place(navigation, lasting, lasting, out)
    row = 0
    for name in (PATH_POSITION, PATH_ORIENTATION):
        if at[name] >= 0:
            kept = math.exp(-duration / model.lasting[0])  # (15)
            for axis in range(3):
                for s in range(points.shape[1]):
                    points[at[name] + axis, s] *= kept
            fresh = model.lasting[1 + name - PATH_POSITION] * math.sqrt(1.0 - kept * kept)
            for axis in range(3):
                out[row + axis, row + axis] = fresh
            row += 3
    return out


@part_of_kernel
def disturbed(model, centre, noise):
    """Return the centre (size,) with columns of noise (c, k) put in, (size, 2 k): all in plus, then in minus."""
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
def predicted_poses(model, motion, regressor, resting, t, before, after, points, columns, own):
    """Return attitude (4, m) and position (3, m) the reference should show, a moment t (m,) after the last sample.

    before and after are the sampling intervals beside it, regressor (6, e) that of the robot's errors, columns and
    own (m,) each point's column of the integrated motion, and its sigma point.
    """
    at, m = model.stored, points.shape[1]
    q, p = np.empty((4, m)), np.empty((3, m))
    composition.pose_at(
        t, before, after, columns, own, motion.q_first, motion.omega, motion.alpha, motion.force, motion.gravity,
        motion.earth_rate, rows_from(points, at[ATTITUDE], 4), rows_from(points, at[VELOCITY], 3),
        rows_from(points, at[POSITION], 3), q, p,
    )  # fmt: skip
    of_position = at[REST_POSITION if resting else PATH_POSITION]
    of_attitude = at[REST_ORIENTATION if resting else PATH_ORIENTATION]
    if of_position >= 0:
        for axis in range(3):
            for s in range(m):
                p[axis, s] += points[of_position + axis, s]
    if of_attitude >= 0:
        rotation.plus(q, rows_from(points, of_attitude, 3), q)
    if regressor.shape[1] == 0:
        return q, p
    # (13). The reported pose is the nominal arm's: the tool's own, less what the arm's errors add to it.
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
def observe(model, signal, steps, i, motion, points, noise):
    """Return what points predict (m, 2 n + 1), and the measurement (m,), as distances from the centre's prediction.

    Between the two: the same for the centre with noise in it, (m, 2 k), all in plus, then all in minus.
    """
    stamps, start, skew, tau = signal.stamps, motion.around[7], motion.around[8], steps.tau[i]
    sigma, last, resting = points.shape[1], steps.last[i], steps.resting[i]
    others = disturbed(model, column_of(points, 0), noise)
    t, t_centre = np.empty(sigma), np.empty(1)
    for s in range(sigma):
        t[s] = start[s] + (1.0 + skew[s]) * tau - stamps[last]  # (11)
    t_centre[0] = t[0]
    before, after = stamps[last] - stamps[last - 1], stamps[last + 1] - stamps[last]
    same = np.zeros(others.shape[1], dtype=np.int64)
    regressor = steps.regressor[i]
    q, p = predicted_poses(model, motion, regressor, resting, t, before, after, points, model.which, np.arange(sigma))
    q_others, p_others = predicted_poses(model, motion, regressor, resting, t_centre, before, after, others, same, same)
    m = 3 * (steps.given[0] + steps.given[1] + resting)
    seen, seen_others, measured = np.empty((m, sigma)), np.empty((m, others.shape[1])), np.empty((m, 1))
    row = 0
    if steps.given[0]:
        for axis in range(3):
            measured[axis, 0] = steps.position[i, axis] - p[axis, 0]
        distances(p, 0, p, 0, seen, 0)
        distances(p_others, 0, p, 0, seen_others, 0)
        row = 3
    if steps.given[1]:
        centre, quaternion = np.empty((4, 1)), np.empty((4, 1))
        for j in range(4):
            centre[j, 0] = q[j, 0]
            quaternion[j, 0] = steps.quaternion[i, j]
        rotation.minus(q, centre, rows_from(seen, row, 3))
        rotation.minus(q_others, centre, rows_from(seen_others, row, 3))
        rotation.minus(quaternion, centre, rows_from(measured, row, 3))
        row += 3
    if resting:
        at = model.stored[VELOCITY]
        for axis in range(3):
            measured[row + axis, 0] = -points[at + axis, 0]  # (14)
        distances(points, at, points, at, seen, row)
        distances(others, at, points, at, seen_others, row)
    return seen, seen_others, column_of(measured, 0)


@kernel
def distances(points, at, centre, centre_at, out, row):
    """Write three rows of points less those of the first column of `centre` into out, from a row on."""
    for axis in range(3):
        for s in range(points.shape[1]):
            out[row + axis, s] = points[at + axis, s] - centre[centre_at + axis, 0]


@kernel
def run(model, signal, steps, begin, end, gates, most, mean, upper, record, rejected):
    """Carry a belief over the updates from `begin` to `end`, in place.

    Parameters
    ----------
    gates : (10,)
        Bound of the normalised innovation squared for every number of degrees.
    most
        Measurements rejected in a row after which to stop.
    mean, upper : (size,), (n, n)
        The belief, its factor transposed.
    record : Record
    rejected : (1,)
        Measurements rejected in a row.

    Returns
    -------
    int
        The update it stopped before: less than `end` if too many measurements were rejected in a row, or the
        state is no longer finite.
    """
    n, size, at = upper.shape[0], mean.size, model.stored
    points = np.empty((size, 2 * n + 1))
    for i in range(begin, end):
        first, last = steps.first[i], steps.last[i]
        duration = signal.stamps[last] - signal.stamps[first]
        for j in range(model.walking.size):
            triangular.widen(upper, model.walking[j], model.walk[j] * math.sqrt(duration))
        sigma_points.draw(model.parts, mean, upper, model.weights[sigma_points.SPREAD], points)
        motion = propagate(model, signal, first, last, points)
        noise = process_noise(model, motion.noise, duration, points)
        seen, seen_noise, innovation = observe(model, signal, steps, i, motion, points, noise)
        velocity, omega = (
            column_of(rows_from(points, at[VELOCITY], 3), 0),
            column_of(motion.omega, 0),
        )
        by_reference = measurement_noise(model, steps.resting[i], steps.given, velocity, omega)
        m = innovation.size
        used, nis, innovation_factor, whitened, gain = sigma_points.use(
            model.parts, model.tail, model.weights, mean, upper, seen, seen_noise, innovation, noise, points,
            by_reference, gates[m],
        )  # fmt: skip
        rejected[0] = 0 if used else rejected[0] + 1
        note(record, i, used, mean, innovation, whitened, innovation_factor, by_reference, gain)
        sigma_points.deviations(upper, i, record.deviation)
        if not math.isfinite(nis) or rejected[0] >= most:
            return i + 1
    return end


@part_of_kernel
def note(record, i, used, mean, innovation, whitened, innovation_factor, measurement_factor, gain):
    """Note in the record what an update leaves."""
    n, m = gain.shape
    record.used[i] = used
    for j in range(mean.size):
        record.mean[i, j] = mean[j]
    for r in range(m):
        record.innovation[i, r] = innovation[r]
        record.whitened[i, r] = whitened[r]
        for j in range(m):
            record.factor[i, r, j] = innovation_factor[r, j]
            variance = 0.0
            for e in range(measurement_factor.shape[1]):
                variance += measurement_factor[r, e] * measurement_factor[j, e]
            record.noise[i, r, j] = variance
        for j in range(3):
            record.gain[i, j, r] = gain[n - 9 + j, r]
            record.gain[i, 3 + j, r] = gain[n - 3 + j, r]

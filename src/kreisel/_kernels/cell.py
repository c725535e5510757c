"""What the compiled filter is given of a cell, and what it records: arrays and numbers alone."""

from __future__ import annotations

from typing import NamedTuple

from kreisel._kernels.arrays import Array, Indices, Mask

VELOCITY, POSITION, ATTITUDE, STANDSTILL_POSITION, STANDSTILL_ORIENTATION, PATH_POSITION, PATH_ORIENTATION = range(7)
"""Places of parts in `Model.stored`."""

AT_POSITION, AT_ORIENTATION, JITTER_POSITION, JITTER_ORIENTATION, STANDSTILL_VELOCITY, STAMP = range(6)
"""Places of figures in `Model.noise`: reference on the path and at standstill, velocity at standstill, stamps."""

MEASURED = 9
"""Most numbers a measurement has: position, orientation, velocity."""


class ParameterRows(NamedTuple):
    """Where some numbers of the model come from: rows of the stored state, or, where -1, known values.

    source, known (e,).
    """

    source: Indices
    known: Array


class Model(NamedTuple):
    """What a cell's filter needs to know besides state, readings and poses.

    Attributes
    ----------
    parts, tail : (p, 4), (t, 4)
        Tables of `manifold` for the state, and for its last parts alone, which change between updates.
    weights : (5,)
        See `sigma_point_filter.SPREAD`.
    gyro, accel, around, robot : ParameterRows
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
    coloured : (3,)
        Time constant of the reference's coloured noise, s, and its deviations in position and orientation.
    walking, walk : (w,)
        Degrees of freedom that walk, and their densities.
    noise_step
        Seconds of readings whose noise is taken together.
    """

    parts: Indices
    tail: Indices
    weights: Array
    gyro: ParameterRows
    accel: ParameterRows
    around: ParameterRows
    robot: ParameterRows
    turning: Indices
    sharing: Indices
    which: Indices
    stored: Indices
    order: int
    products: float
    inside: bool
    level: float
    down: float
    noise: Array
    coloured: Array
    walking: Indices
    walk: Array
    noise_step: float


class Steps(NamedTuple):
    """Updates in their order: samples, reference seconds, pose, regressor of the robot's errors.

    first, last, tau, at_standstill (u,); position (u, 3), quaternion (u, 4), of which `given` (2,) says whether
    they are measured; regressor (u, 6, e), with e = 0 without a robot.
    """

    first: Indices
    last: Indices
    tau: Array
    at_standstill: Mask
    position: Array
    quaternion: Array
    given: Mask
    regressor: Array


class Record(NamedTuple):
    """What updates leave: see `filtering.history.History`.

    mean (u, size), deviation (u, n), used (u,); innovation and whitened (u, 9), their factor and the
    noise's covariance (u, 9, 9), gain of velocity and attitude (u, 6, 9). Of the nines the first m count.
    """

    mean: Array
    deviation: Array
    used: Mask
    innovation: Array
    whitened: Array
    factor: Array
    noise: Array
    gain: Array


class IntegratedMotion(NamedTuple):
    """The motion to an update: what carries sigma points on to the reference's own time, and its noise.

    Columns of omega, alpha (3, M) and force (3, 3, M) are those of `Model.which`; q_first (4, 2 n + 1), gravity and
    earth_rate (3, 2 n + 1) and around (10, 2 n + 1) have one for each sigma point. noise (9, 9): factor of noise in
    velocity, position and attitude.
    """

    q_first: Array
    omega: Array
    alpha: Array
    force: Array
    gravity: Array
    earth_rate: Array
    around: Array
    noise: Array


class Moments(NamedTuple):
    """Moments after the last sample of an interval, one for each column of a state.

    Attributes
    ----------
    dt : (k,)
        s, by at most a sampling interval.
    before, after
        Sampling intervals on either side of the last sample, s.
    which : (m,)
        Each state's column of the integrated motion.
    own : (m,)
        Each state's place in `dt`, and its column of what belongs to a sigma point.
    """

    dt: Array
    before: float
    after: float
    which: Indices
    own: Indices


class Gate(NamedTuple):
    """What rejects an update.

    Attributes
    ----------
    bounds : (10,)
        Of the normalised innovation squared, for every number of degrees of freedom.
    most
        Measurements rejected in a row after which to stop.
    rejected : (1,)
        Measurements rejected in a row so far.
    """

    bounds: Array
    most: int
    rejected: Indices

"""What the compiled filter is given of a cell, and what it records: arrays and numbers alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

VELOCITY, POSITION, ATTITUDE, STANDSTILL_POSITION, STANDSTILL_ORIENTATION, PATH_POSITION, PATH_ORIENTATION = range(7)
"""Places of parts in `Model.stored`."""

AT_POSITION, AT_ORIENTATION, JITTER_POSITION, JITTER_ORIENTATION, STANDSTILL_VELOCITY, STAMP = range(6)
"""Places of figures in `Model.noise`: reference on the path and at standstill, velocity at standstill, stamps."""

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
        See `sigma_point_filter.SPREAD`.
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
    coloured : (3,)
        Time constant of the reference's coloured noise, s, and its deviations in position and orientation.
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
    coloured: np.ndarray
    walking: np.ndarray
    walk: np.ndarray
    noise_step: float


class Steps(NamedTuple):
    """Updates in their order: samples, reference seconds, pose, regressor of the robot's errors.

    first, last, tau, at_standstill (u,); position (u, 3), quaternion (u, 4), of which `given` (2,) says whether
    they are measured; regressor (u, 6, e), with e = 0 without a robot.
    """

    first: np.ndarray
    last: np.ndarray
    tau: np.ndarray
    at_standstill: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    given: np.ndarray
    regressor: np.ndarray


class Record(NamedTuple):
    """What updates leave: see `filtering.history.History`.

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

    dt: np.ndarray
    before: float
    after: float
    which: np.ndarray
    own: np.ndarray


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

    bounds: np.ndarray
    most: int
    rejected: np.ndarray

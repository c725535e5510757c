"""What the compiled filter is given of a cell, and what it records: arrays and numbers alone."""

from __future__ import annotations

from typing import NamedTuple

from kreisel._kernels.compiled import check_count, order
from kreisel._kernels.views import IndexTable, Indices, Mask, Numbers, Stack, Table

STORED, NOISE, COLOURED = order("Stored"), order("Noise"), order("Coloured")
"""Places of parts in `Model.stored`, and of figures in `Model.noise` and `Model.coloured`, by name."""

WEIGHTS = tuple(order("Weights"))
"""Figures of `estimation.sigma_points.SigmaWeights` in the order of `Model.weights`."""

GYRO, ACCEL, AROUND = order("Gyro"), order("Accel"), order("Around")
"""Places of groups in `Model.gyro`, `Model.accel` and `Model.around`, by name."""

MEASURED = 9
"""Most numbers a measurement has: position, orientation, velocity."""

check_count("measured", MEASURED)


class Samples(NamedTuple):
    """Readings with all quantities that do not depend on the sensor parameters.

    Attributes
    ----------
    stamps : (n,)
        Seconds since the first sample.
    base, single, twice : (n - 1,), (n - 1, 6), (n - 1, 6)
        Stencils of `quadrature`.
    rates : (P, n)
        Features of the rate, P = 4 + E: see `coefficients`.
    slopes : (4, n)
        Derivatives of the first four.
    integrals : (P, n - 1)
        Integrals of the features over each sampling interval.
    forces : (3 + E, n)
        The accelerometers' readings, and the features of their effects.
    noise : (4, 3)
        Of gyros and accelerometers, axis by axis: spectral densities (unit squared times seconds) of each, then the
        curvature of each (unit per second squared) where samples are missing: see `preintegration.noise_covariance`.
    usual
        Usual time between two samples, s.
    """

    stamps: Numbers
    base: Indices
    single: Table
    twice: Table
    rates: Table
    slopes: Table
    integrals: Table
    forces: Table
    noise: Table
    usual: float


class ParameterRows(NamedTuple):
    """Where some numbers of the model come from: rows of the stored state, or, where -1, known values.

    source, known (e,).
    """

    source: Indices
    known: Numbers


class Model(NamedTuple):
    """What a cell's filter needs to know besides state, readings and poses.

    Attributes
    ----------
    parts, tail, sampled : (p, 4), (t, 4), (d, 4)
        Tables of `manifold` for the state; for its last parts alone, which change between updates; and for the parts of
        which sigma points are needed: all but the robot's errors, which enter linearly.
    weights : (5,)
        See `WEIGHTS`.
    gyro, accel, around, robot : ParameterRows
        Matrix, offset and effects of the gyros; the same, with lever arms before the effects, of the accelerometers;
        alignment, north, gravity, time offset and skew, Earth rate downward; errors of the reported poses.
    gyro_degrees, sensor_degrees
        Degrees of freedom of the gyros' parameters, which come first, and of both sensors' parameters.
    stored : (7,)
        Where the parts of `STORED` lie in the stored state, -1 where they are not in it.
    gyro_effects, accel_effects : (E, 3)
        Which of the effects' parameters each feature is multiplied by in each axis; -1 for none.
    gyro_applied, accel_applied : (e,)
        Values of these parameters by which the readings have been corrected before.
    printed
        Whether the size effect is that of the printed paper.
    level, down
        Earth rate that a unit of north, and of its downward part, stands for, rad/s.
    noise : (6,)
        Standard deviations; see `NOISE`.
    standstill : (2,)
        Deviations of the reference's error at a standstill, in position and orientation.
    coloured : (3,)
        Time constant of the reference's coloured noise, s, and its deviations in position and orientation.
    walking, walk, fading : (w,)
        Degrees of freedom that walk, their densities, and the rates, 1/s, at which what they were fades.
    noise_step
        Seconds of readings whose noise is taken together.
    linear
        Linearisations of an update by derivatives, at most; 0 for sigma points.
    varying : (s,)
        Degrees of freedom whose covariance with all others is recorded.
    """

    parts: IndexTable
    tail: IndexTable
    sampled: IndexTable
    weights: Numbers
    gyro: ParameterRows
    accel: ParameterRows
    around: ParameterRows
    robot: ParameterRows
    gyro_degrees: int
    sensor_degrees: int
    stored: Indices
    gyro_effects: IndexTable
    accel_effects: IndexTable
    gyro_applied: Numbers
    accel_applied: Numbers
    printed: bool
    level: float
    down: float
    noise: Numbers
    standstill: Numbers
    coloured: Numbers
    walking: Indices
    walk: Numbers
    fading: Numbers
    noise_step: float
    linear: int
    varying: Indices


class Steps(NamedTuple):
    """Updates in their order: samples, reference seconds and their deviation, pose, regressor of the robot's errors.

    first, last, tau, stamp, at_standstill, new_standstill (u,); position (u, 3), quaternion (u, 4), of which `given`
    (2,) says whether they are measured; regressor (u, 6, e), with e = 0 without a robot; about (u, a), the first
    numbers of the stored state that derivatives are taken about: the rest are those of the mean.
    """

    first: Indices
    last: Indices
    tau: Numbers
    stamp: Numbers
    at_standstill: Mask
    new_standstill: Mask
    position: Table
    quaternion: Table
    given: Mask
    regressor: Stack
    about: Table


class Record(NamedTuple):
    """What updates leave: see `fitting.update_history.History`, whose names some fields have.

    mean (u, first numbers of the stored state), deviation (u, first degrees of freedom), used (u,); nis,
    log_likelihood, turn_information (u,); whitened, innovation, residual, noise_variance (u, 9): position, orientation,
    velocity, nan where there is no such measurement; passing (u, 6), velocity and rate of b; late (u, 2), error of the
    stamp by the innovation, with its deviation; correction, correction_variance (u, 6).

    What a small change of the state before an update does, without tables where it is not asked for: transition
    (u, c, n) to the c degrees of freedom that move; design (u, 9, n) to the whitened measurement, and gain (u, 9, n),
    transposed, what that does to the state; whitening (u, 9, 9) times a measurement is the whitened one.
    Before each update, likewise: before (u, size), the mean, and covariance (u, s, n) of what varies with all.
    """

    mean: Table
    deviation: Table
    used: Mask
    nis: Numbers
    log_likelihood: Numbers
    turn_information: Numbers
    whitened: Table
    innovation: Table
    residual: Table
    noise_variance: Table
    passing: Table
    late: Table
    correction: Table
    correction_variance: Table
    transition: Stack
    design: Stack
    gain: Stack
    whitening: Stack
    before: Table
    covariance: Stack


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

    bounds: Numbers
    most: int
    rejected: Indices


class Gaussian(NamedTuple):
    """Mean (size,) as stored, and factor (n, n) of the covariance, transposed: upper triangular."""

    mean: Numbers
    upper: Table

"""What preintegration takes and gives: samples, coefficients of the sensor parameters, motion between two samples."""

from __future__ import annotations

from typing import NamedTuple

from kreisel._kernels.arrays import Array


class Span(NamedTuple):
    """Samples of an increment: its first and last, and those that enter, two beyond either end where there are."""

    first: int
    last: int
    low: int
    high: int


class Coefficients(NamedTuple):
    """Sensor parameters as coefficients, see `coefficients`: the columns of `shared` turn as the first of `rate` does.

    rate, force, shared: (P, 3, m), (features, 3, m), (features, 3, M - m).
    """

    rate: Array
    force: Array
    shared: Array


class Increments(NamedTuple):
    """Motion between two samples, one column for each parameter set, seen from the body's attitude at the first.

    Attributes
    ----------
    dq, dv, dp : (4, M), (3, M), (3, M)
    omega_end, alpha_end : (3, M)
        Rate and angular acceleration at the last sample.
    u_end : (3, 3, M)
        Specific force at the last sample and its two neighbours.
    u_path, q_path : (c, 3), (c, 4)
        Specific force and attitude along the way, of the first column.
    """

    dq: Array
    dv: Array
    dp: Array
    omega_end: Array
    alpha_end: Array
    u_end: Array
    u_path: Array
    q_path: Array

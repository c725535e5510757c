"""What an update leaves in a record, by itself."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

from kreisel._kernels.filter_arguments import Record
from kreisel._kernels.views import Array, Indices, Numbers, Pointer, Table, padded

from .compiled_parts import function


class MeasuredArrays(NamedTuple):
    """What `record_update` is given of an update."""

    innovation: Numbers
    passing: Numbers
    noise: Table
    factor: Table
    whitened: Numbers
    gain: Table
    place: Indices


_record_update = function(
    "record_update", Pointer(Record), ctypes.c_int64, Pointer(MeasuredArrays), ctypes.c_int64, ctypes.c_int64
)


def record_update(
    record: Record, i: int, innovation: Array, passing: Array, noise: Array, factor: Array, whitened: Array,
    gain: Array, place: Indices, *, used: bool,
) -> None:  # fmt: skip
    """Write into a record what update i leaves of a measurement of m numbers.

    Parameters
    ----------
    innovation, whitened : (m,)
    passing : (6,)
        Velocity and rate.
    noise, factor : (m, e), (m, m)
        Factor of the measurement's noise; of the innovation's covariance, lower triangular.
    gain : (n, m)
        On the whitened innovation; the last nine degrees of freedom are velocity, position and attitude.
    place : (m,)
        Where the numbers stand among position, orientation and velocity.
    """
    of = MeasuredArrays(innovation, passing, noise, factor, whitened, padded(gain.T), place)
    _record_update(record, i, of, len(gain), int(used))

"""Types of what the kernels are given: arrays of numbers, of indices and of truth values, and prepared readings.

Annotations are for the reader and the type checker; numba compiles for the types of the arguments of a call.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


class PreparedReadings(Protocol):
    """Readings with all quantities that do not depend on the sensor parameters.

    A protocol, because the named tuple itself, `inertial.strapdown.Samples`, belongs to a package above this one.
    Its docstring describes the fields; P = 1 + 3 N.
    """

    @property
    def stamps(self) -> Array:
        """(n,)."""

    @property
    def base(self) -> Indices:
        """(n - 1,)."""

    @property
    def single(self) -> Array:
        """(n - 1, 6)."""

    @property
    def double(self) -> Array:
        """(n - 1, 6)."""

    @property
    def rates(self) -> Array:
        """(P, n)."""

    @property
    def slopes(self) -> Array:
        """(P, n)."""

    @property
    def integrals(self) -> Array:
        """(P, n - 1)."""

    @property
    def forces(self) -> Array:
        """(3 N, n)."""

    @property
    def noise(self) -> Array:
        """(4, 3)."""

    @property
    def usual(self) -> float:
        """A plain number, s."""

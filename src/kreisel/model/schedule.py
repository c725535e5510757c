"""Which pose is used when, and over which samples the motion is integrated in between."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices
from kreisel.model.standstill import ImuStillness, Standstill
from kreisel.synchronization.clock import Clock

MIN_UPDATES = 20
"""Minimum number of updates for an estimate."""


@dataclass(frozen=True)
class Update:
    """One use of the reference.

    Attributes
    ----------
    first, last
        Samples the motion is integrated over since the update before.
    pose, tau
        Index of the pose and its reference seconds.
    standstill
        Index of the standstill it lies in, or None on the path.
    new_standstill, new_segment
        Whether it is the first in its standstill, and whether navigation starts again here.
    """

    first: int
    last: int
    pose: int
    tau: float
    standstill: int | None
    new_standstill: bool
    new_segment: bool

    def begun_anew(self) -> Update:
        """Return the update as the first of those that navigation starts with."""
        return replace(self, first=self.last, new_segment=True, new_standstill=self.standstill is not None)


@dataclass(frozen=True)
class Schedule:
    """The updates of a problem.

    Attributes
    ----------
    updates
        In the order of time.
    interval
        Usual time between two of them, s.
    clock
        The clocks by which poses were assigned to samples, and standstills found.
    standstills
        Intervals of standstill.
    stillness
        When the IMU stands still, for standstills by other clocks; None where standstills are given.
    attitude : (updates, 4)
        Rough q_rb at every update where the reference has no attitude: navigation starts with it. Else the identity.
    attitude_sd
        Its standard deviation, rad.
    """

    updates: tuple[Update, ...]
    interval: float
    clock: Clock
    standstills: tuple[Standstill, ...]
    attitude: Array
    attitude_sd: float = 0.2
    stillness: ImuStillness | None = field(default=None, repr=False)

    @property
    def samples(self) -> tuple[Indices, Indices]:
        """First and last sample between each update and the one before, (u,) each."""
        return np.array([u.first for u in self.updates]), np.array([u.last for u in self.updates])

    @property
    def poses(self) -> Indices:
        """The poses of the updates, (updates,)."""
        return np.array([update.pose for update in self.updates], dtype=np.int64)

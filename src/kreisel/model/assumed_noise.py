"""Assumed errors of reference and IMU: what the filter treats as noise, and what is added to its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices, Mask

COLOURED_SHARE = 0.9
"""Share of the variance of the reference's noise on the path that is coloured, if that raises the likelihood."""

REACH = 1.0
"""m; length over which angle errors of a robot act on positions, and its length errors on their scale."""


@dataclass(frozen=True)
class ReferenceNoise:
    """Standard deviations of the reference's poses (m, rad), velocity at standstill (m/s) and stamps (s).

    At standstill the error is one draw for the whole standstill (`standstill_*`) plus a small scatter (`jitter_*`).
    """

    position: float
    orientation: float
    standstill_position: float
    standstill_orientation: float
    jitter_position: float
    jitter_orientation: float
    velocity: float
    stamp: float

    def scaled(self, *, position: float, orientation: float, standstill: float) -> ReferenceNoise:
        """Return the noise with its deviations multiplied by factors: on the path, and all of those at standstill."""
        return replace(
            self,
            position=self.position * position,
            orientation=self.orientation * orientation,
            standstill_position=self.standstill_position * standstill,
            standstill_orientation=self.standstill_orientation * standstill,
            jitter_position=self.jitter_position * standstill,
            jitter_orientation=self.jitter_orientation * standstill,
            velocity=self.velocity * standstill,
        )


@dataclass(frozen=True)
class PoseError:
    """Error of reported poses that is a function of the arm's posture: of equal size at all poses, and correlated.

    Attributes
    ----------
    position, orientation
        Standard deviations, m and rad; zero where there is no arm, or its errors are estimated.
    time
        Time over which the arm, in this motion, keeps nearly the same posture, s.
    assumed
        Whether nothing is stated of their size.
    repeated
        By how much they count as larger than they are, for an error comes back with its posture.
    reached
        How large they are in this motion, over what they are where all attitudes are reached.
    """

    position: float = 0.0
    orientation: float = 0.0
    time: float = 0.0
    assumed: bool = False
    repeated: float = 1.0
    reached: float = 1.0

    def larger(self, factor: float) -> PoseError:
        """Return the error times a factor."""
        return replace(self, position=factor * self.position, orientation=factor * self.orientation)


@dataclass(frozen=True)
class ColouredNoise:
    """Coloured (Gauss-Markov) noise of the reference on the path: its time constant (s) and size (m, rad).

    The deviations of the path's noise are multiplied by `white_factor` for the part that is white.
    """

    time: float
    position: float
    orientation: float
    white_factor: float


@dataclass(frozen=True)
class GaussMarkov:
    """A passing change of offsets, a Gauss-Markov process: its deviation, SI, and its time constant, s."""

    size: float
    time: float


@dataclass(frozen=True)
class AssumedNoise:
    """Errors the filter assumes.

    Attributes
    ----------
    reference
        Noise of the reference.
    min_reference
        Least deviations of position (m) and orientation (rad) on the path to which the data may change them.
    imu_bounds
        Least and largest noise density of the gyros, and of the accelerometers, to which the data may change them.
    offset_walk
        Density of the random walk of each group of offsets.
    gauss_markov
        Passing changes of the offsets beside it, by the groups that stand for them.
    rate_scatter
        Standard deviation of the noise in a single reading of a gyro, rad/s.
    observed
        Noise densities of gyros and accelerometers that the readings themselves show.
    misstated
        Sensors of which nothing that is stated is used, and how many times as noisy they are at rest.
    correlation_time
        Time constant of the reference's coloured noise, s; 0 where the noise is white.
    frame_sd
        Standard deviations of base and tool frame from the reference's, m and rad, if no other error represents them.
    volume_sd
        Relative deviation of the scale of cameras' positions; 0 for an arm.
    axes, axis_sd
        Axes (3, 3; rows, in b) that all rotation is about, one after the other, and how far an arm may turn about
        others, rad; (0, 3) where rotations are about all directions.
    pose_error
        Effect of an arm's geometric errors on its reported poses, where they are not estimated.
    lateness
        Delay that all stamps of the IMU or the reference may have in common, s.
    time_base_sd
        Relative deviation of the IMU's seconds from true ones.
    stamps : (m,)
        Standard deviation of the stamp of every pose, s; (0,) where all are those of `reference`.
    persists
        Whether lasting errors of poses are there at standstill, too: coloured noise, and errors on no list.
    unlisted
        Rms of the errors of poses on no list that were found and taken out, m and rad.
    """

    reference: ReferenceNoise
    min_reference: tuple[float, float]
    imu_bounds: tuple[tuple[float, float], tuple[float, float]]
    offset_walk: dict[str, float]
    gauss_markov: Mapping[str, GaussMarkov] = field(default_factory=dict)
    rate_scatter: float = 0.0
    observed: Array = field(default_factory=lambda: np.full((2, 3), np.inf))
    misstated: Mapping[str, float] = field(default_factory=dict)
    correlation_time: float = 0.0
    frame_sd: tuple[float, float] = (0.0, 0.0)
    volume_sd: float = 0.0
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    axis_sd: float = 0.0
    pose_error: PoseError = PoseError()
    lateness: float = 0.0
    time_base_sd: float = 0.0
    stamps: Array = field(default_factory=lambda: np.zeros(0))
    persists: bool = False
    unlisted: tuple[float, float] = (0.0, 0.0)

    def stamp_deviations(self, poses: Indices) -> Array:
        """Return the standard deviations of the stamps of some poses, s."""
        return self.stamps[poses] if self.stamps.size else np.full(len(poses), self.reference.stamp)

    @property
    def coloured(self) -> ColouredNoise:
        """The reference's coloured noise: the part found by likelihood, and that of an arm's geometry."""
        own = self.pose_error
        if self.correlation_time == 0.0:
            return ColouredNoise(own.time, own.position, own.orientation, 1.0)
        found = self._found
        size = (math.hypot(found[0], own.position), math.hypot(found[1], own.orientation))
        return ColouredNoise(self.correlation_time, *size, (1.0 - COLOURED_SHARE) ** 0.5)

    @property
    def _found(self) -> tuple[float, float]:
        """Sizes of the coloured noise that was found by likelihood, m and rad."""
        return COLOURED_SHARE**0.5 * self.reference.position, COLOURED_SHARE**0.5 * self.reference.orientation

    @property
    def at_rest(self) -> tuple[float, float]:
        """Error of the pose at a standstill by the reference's own noise, drawn once for each, m and rad."""
        position, orientation = self.reference.standstill_position, self.reference.standstill_orientation
        if not self.persists:
            return position, orientation
        found = (0.0, 0.0) if self.correlation_time == 0.0 else self._found
        return max(position, found[0], self.unlisted[0]), max(orientation, found[1], self.unlisted[1])

    @property
    def standstill_error(self) -> tuple[float, float]:
        """Error of the pose at a standstill, drawn once for each, m and rad."""
        (position, orientation), own = self.at_rest, self.pose_error
        return math.hypot(position, own.position), math.hypot(orientation, own.orientation)


def stamps_of(usual: float, wrong: Mask, interval: float) -> Array:
    """Return the deviations of stamps (m,): as usual, or as long as from pose to pose; (0,) if none is wrong."""
    return np.where(wrong, interval, usual) if wrong.any() else np.zeros(0)

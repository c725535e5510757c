"""Where the robot stands still, judged by the reference's motion and the IMU's readings together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, conjugate, log, multiply
from kreisel.inertial.earth import EARTH_RATE
from kreisel.recording import ImuSamples, ReferencePoses
from kreisel.synchronization import Clock

SHORTEST = 0.2
"""Seconds a rest must last, margins taken off."""

MARGIN = 0.15
"""Seconds left out at either end, where the arm still swings and its reported pose still settles."""

_WINDOW = 0.2
_ALWAYS_STILL = (0.01, 0.05)
_NEVER_STILL = (0.06, 0.8)


@dataclass(frozen=True)
class Rest:
    """A stretch of standstill: IMU seconds, margins already taken off."""

    start: float
    stop: float


def find_rests(
    imu: ImuSamples, reference: ReferencePoses, clock: Clock, position_sd: float, orientation_sd: float
) -> tuple[Rest, ...]:
    """Return the stretches in which neither reference nor IMU moves.

    Parameters
    ----------
    position_sd, orientation_sd
        The reference's noise, m and rad, which looks like motion too.

    Notes
    -----
    The IMU's threshold lies three times above the quietest tenth of its windows, within bounds: a machine
    that never rests has no quiet windows at that level and the reference has the last word.
    """
    still = _imu_still(imu)
    t = imu.seconds
    limits = (0.004 + 4.0 * position_sd, 0.004 + 8.0 * orientation_sd)
    moving = _reference_moving(reference, clock, t, limits)
    calm = still & ~moving
    edges = np.diff(np.concatenate([[0], calm.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple(
        Rest(float(t[a]) + MARGIN, float(t[b]) - MARGIN)
        for a, b in zip(starts, stops, strict=True)
        if t[b] - t[a] >= SHORTEST + 2.0 * MARGIN
    )


@dataclass(frozen=True)
class OutsideRest:
    """Rest the IMU recorded before the reference began or after it ended.

    Attributes
    ----------
    rate : (3,)
        Mean reading of the gyros, rad/s.
    seconds
        How long it lasted.
    """

    rate: Array
    seconds: float

    def deviation(self, density: Array) -> Array:
        """Return the standard deviation of the rate as the gyros' offset, (3,).

        Parameters
        ----------
        density : (3,)
            Noise density of the gyros. The Earth's rate, of unknown direction here, is an error too; twice
            the sum is taken, as offsets wander.
        """
        return np.asarray(2.0 * np.sqrt(density**2 / self.seconds + EARTH_RATE**2))


def rest_outside(imu: ImuSamples, reference: ReferencePoses, clock: Clock) -> OutsideRest | None:
    """Return the longest rest outside the reference's time, or None where it is shorter than two seconds."""
    t = imu.seconds
    first, last = clock.imu_time(reference.seconds[[0, -1]])
    still = _imu_still(imu) & ((t < first) | (t > last))
    edges = np.diff(np.concatenate([[0], still.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    if starts.size == 0:
        return None
    longest = int(np.argmax(t[stops] - t[starts]))
    part = slice(starts[longest], stops[longest] + 1)
    seconds = float(t[stops[longest]] - t[starts[longest]])
    if seconds < 2.0:
        return None
    return OutsideRest(imu.rates[part].mean(axis=0), seconds)


def _imu_still(imu: ImuSamples) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    n = max(3, round(_WINDOW / imu.interval))
    rate = _spread(imu.rates, n)
    force = _spread(imu.accelerations, n)
    limit_rate = np.clip(3.0 * np.percentile(rate, 10), _ALWAYS_STILL[0], _NEVER_STILL[0])
    limit_force = np.clip(3.0 * np.percentile(force, 10), _ALWAYS_STILL[1], _NEVER_STILL[1])
    return np.asarray((rate < limit_rate) & (force < limit_force))


def _spread(values: Array, n: int) -> Array:
    """Return the standard deviation within a centred window of n samples, all axes together."""
    centred = values - values.mean(axis=0)
    sums = np.zeros((len(values) + 1, 4))
    np.cumsum(np.column_stack([centred, (centred**2).sum(axis=1)]), axis=0, out=sums[1:])
    mean = (sums[n:] - sums[:-n]) / n
    inside = np.sqrt(np.maximum(mean[:, 3] - (mean[:, :3] ** 2).sum(axis=1), 0.0))
    return np.pad(inside, (n // 2, len(values) - inside.size - n // 2), mode="edge")


def _reference_moving(
    reference: ReferencePoses, clock: Clock, t: Array, limits: tuple[float, float]
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return for IMU times whether the reference moves, by its displacement over a third of a second."""
    tau = reference.seconds
    stride = max(1, round(0.3 / reference.interval))
    span = tau[stride:] - tau[:-stride]
    moving = np.zeros(span.size, dtype=bool)
    if reference.positions is not None:
        moving |= (
            np.linalg.norm(reference.positions[stride:] - reference.positions[:-stride], axis=1) / span > limits[0]
        )
    if reference.quaternions is not None:
        turned = log(multiply(conjugate(reference.quaternions[:-stride]), reference.quaternions[stride:]))
        moving |= np.linalg.norm(turned, axis=1) / span > limits[1]
    middle = clock.imu_time(0.5 * (tau[stride:] + tau[:-stride]))
    nearest = np.clip(np.searchsorted(middle, t), 0, middle.size - 1)
    result = moving[nearest]
    result |= (t < clock.imu_time(tau[0])) | (t > clock.imu_time(tau[-1]))
    return np.asarray(result)

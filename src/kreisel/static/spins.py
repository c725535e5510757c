"""Turns by many revolutions: how often gravity went round in the device, whatever its gyros say.

Gyros that are uncalibrated lose count of revolutions, and standstills alone do not show how many there were. The
forces do: across an axis that is not upright, gravity goes round once with each revolution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array, Indices, from_two_vectors, lengths, matrix
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.static.rest_problem import RestProblem

_FEWEST = 4.0
"""Revolutions from which a turn is counted. Chosen: gyros that err by a tenth do not lose count of fewer."""

_LOST = 16.0
"""Revolutions about changing axes from which nothing counts a turn; to and fro they cancel. Chosen: gyros that err by
three per cent may then be half a revolution off."""

_STRAIGHT = 0.98
"""Share of a turn's way that leads along one axis, from which it is about one."""

_WRAPPED = 0.9
"""Share of the range of a gyro's readings that it crosses in one sample if it wraps round: no device turns so fast."""

_AT_END = 3
"""Samples at the end of a gyro's range, from which a turn is cut off: fewer may be the largest rate there was."""

_LEVEL, _EVERY = 0.1, 0.5
"""Gravity across the axis, over all of it, from which it shows revolutions: six degrees from upright; and its mean over
a revolution, over that of most, which each must reach, or the count is lost there."""


def with_counted_spins(problem: RestProblem, start: SensorParameters) -> SensorParameters:
    """Return first values whose gyros turn as often as gravity does in the device, in turns of many revolutions."""
    counted = [(way, ratio) for _, way, ratio in _spins(problem, start) if ratio is not None]
    if not counted:
        return start
    ways = np.array([way for way, _ in counted])
    ratios = np.array([ratio for _, ratio in counted])
    return replace(start, K_omega=leading(ways, ratios[:, None] * ways) @ start.K_omega)


def uncounted(problem: RestProblem, start: SensorParameters) -> Indices:
    """Return the turns of many revolutions that gravity does not count: of these one more or less fits as well."""
    return np.array([m for m, _, ratio in _spins(problem, start) if ratio is None], dtype=np.int64)


def many_revolutions(problem: RestProblem, start: SensorParameters) -> Indices:
    """Return the turns of so many revolutions that uncalibrated gyros lose count."""
    return np.array([m for m, _, _ in _spins(problem, start)], dtype=np.int64)


def cut_off(problem: RestProblem) -> Indices:
    """Return the turns in which a gyro is at the end of its range, or wraps round: nobody knows how far it turned."""
    imu, rests = problem.imu, problem.rests
    ends = np.stack([imu.rates.max(axis=0), imu.rates.min(axis=0)])
    at_end = np.isin(imu.stamps_ns, imu.broken_ns) & (imu.rates[:, None] == ends).any(axis=(1, 2))
    wrapped = (np.abs(np.diff(imu.rates, axis=0)) > _WRAPPED * (ends[0] - ends[1])).any(axis=1)
    before = np.concatenate([[0], np.cumsum(at_end + _AT_END * np.append(wrapped, False))])
    return np.flatnonzero(before[rests.first[1:]] - before[rests.last[:-1]] >= _AT_END)


def _spins(problem: RestProblem, start: SensorParameters) -> Iterator[tuple[int, Array, float | None]]:
    """Yield turns of many revolutions: number, way by the gyros (3,), and the ratio of `_ratio`, if it is about one."""
    imu, rests, whole = problem.imu, problem.rests, steps_of(problem, start)
    for m, (a, b) in enumerate(zip((rests.last[:-1] - 1).tolist(), rests.first[1:].tolist(), strict=True)):
        steps = whole[a:b]
        way = steps.sum(axis=0)
        size, length = float(np.linalg.norm(way)), float(lengths(steps).sum())
        if size < _STRAIGHT * length:
            if float(lengths(np.cumsum(steps, axis=0)).max()) > 2.0 * np.pi * _LOST:
                yield m, way, None
            continue
        if size < 2.0 * np.pi * _FEWEST:
            continue
        force = (imu.accelerations[a : b + 1] + start.k_a[0]) @ start.K_a.T
        between = 0.5 * (force[1:] + force[:-1])
        yield m, way, _ratio(steps @ way / size, between, way / size, problem.site.gravity)


def steps_of(problem: RestProblem, sensors: SensorParameters) -> Array:
    """Return the integral of the rates from sample to sample, (n - 1, 3), rad."""
    rate = (problem.imu.rates + sensors.k_w[0]) @ sensors.K_omega.T
    return np.asarray(0.5 * (rate[1:] + rate[:-1]) * np.diff(problem.imu.seconds)[:, None])


def leading(way: Array, meant: Array) -> Array:
    """Return the matrix (3, 3) near one that leads ways (k, 3) where they are meant to lead, (k, 3), by least squares.

    Along directions that no way has, it is one.
    """
    held = 1e-4 * float(np.sum(way**2)) * np.eye(3)
    return np.asarray(np.linalg.solve(way.T @ way + held, way.T @ meant + held).T)


def _ratio(angle: Array, force: Array, axis: Array, gravity: float) -> float | None:
    """Return how far gravity goes round over how far gyros say, None where it cannot be seen.

    Seen from axes that turn as the gyros say, gravity turns slowly, by what they miss, and forces that turn with the
    device, such as those toward the axis, go round and average out over each revolution.

    angle (n,): steps about the axis by the gyros, rad, positive on the whole; force (n, 3): between.
    """
    across = matrix(from_two_vectors([0.0, 0.0, 1.0], axis))[:, :2]
    total = np.cumsum(angle) - 0.5 * angle
    side = (force @ across) @ np.array([1.0, 1j]) * np.exp(1j * total)
    which = np.floor(total / (2.0 * np.pi)).astype(np.int64)
    revolutions = int(total[-1] // (2.0 * np.pi))
    inside = (which >= 0) & (which < revolutions)
    own, weight = which[inside], angle[inside]
    parts = [np.bincount(own, weight * v, revolutions) for v in (side[inside].real, side[inside].imag)]
    mean = (parts[0] + 1j * parts[1]) / (2.0 * np.pi)
    length = np.abs(mean)
    if np.median(length) < _LEVEL * gravity or length.min() < _EVERY * np.median(length):
        return None
    phase = np.unwrap(np.angle(mean))
    slope = float(np.polyfit(np.arange(revolutions), phase, 1)[0])
    return 1.0 - slope / (2.0 * np.pi)

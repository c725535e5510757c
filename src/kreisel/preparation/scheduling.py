"""Poses chosen as updates, one every interval, and assigned to samples."""

from __future__ import annotations

import numpy as np

from kreisel.geometry.interpolation import nearest
from kreisel.geometry.rotation import Array, Indices
from kreisel.inertial.readings import Readings
from kreisel.model.schedule import Update
from kreisel.model.standstill import Standstill
from kreisel.recording.recording import ReferencePoses


def schedule_updates(
    readings: Readings, t_pose: Array, reference: ReferencePoses, standstills: tuple[Standstill, ...], interval: float
) -> tuple[Update, ...]:
    """Return the updates: one every `interval`, each with the pose nearest to it.

    Parameters
    ----------
    t_pose
        IMU seconds of every pose, by the clocks known so far.
    reference
        The poses; doubtful ones are not used.
    """
    tau, doubtful = reference.seconds, reference.doubtful
    usable = np.ones(tau.size, dtype=bool) if doubtful is None else ~doubtful
    updates: list[Update] = []
    last_standstill: int | None = None
    starts = np.array([standstill.start for standstill in standstills])
    stops = np.array([standstill.stop for standstill in standstills])
    for begin, end in readings.segments:
        low, high = readings.stamps[begin + 1], readings.stamps[end - 1]
        inside = np.flatnonzero((t_pose > low) & (t_pose < high) & usable)
        if inside.size < 2:
            continue
        poses = _spread(t_pose, inside, interval)
        samples = np.clip(nearest(readings.stamps, t_pose[poses]), begin + 1, end - 1)
        previous: int | None = None
        for pose, sample in zip(poses.tolist(), samples.tolist(), strict=True):
            if previous is not None and sample <= previous:
                continue
            standstill = _containing(starts, stops, float(t_pose[pose]))
            updates.append(
                Update(
                    first=sample if previous is None else previous,
                    last=sample,
                    pose=pose,
                    tau=float(tau[pose]),
                    standstill=standstill,
                    new_standstill=standstill is not None and standstill != last_standstill,
                    new_segment=previous is None,
                )
            )
            last_standstill = standstill if standstill is not None else last_standstill
            previous = sample
    return tuple(updates)


def _spread(t_pose: Array, inside: Indices, interval: float) -> Indices:
    """Return the poses nearest to a grid of the given interval, each once."""
    times = t_pose[inside]
    grid = np.arange(times[0], times[-1] + 0.5 * interval, interval)
    places = nearest(times, grid)
    close = np.abs(times[places] - grid) <= 0.5 * interval
    return np.asarray(inside[np.unique(places[close])])


def _containing(starts: Array, stops: Array, t: float) -> int | None:
    if starts.size == 0:
        return None
    k = int(np.searchsorted(starts, t, side="right")) - 1
    return k if k >= 0 and t <= stops[k] else None

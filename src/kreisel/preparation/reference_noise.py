"""Assumed noise of the reference before the filter runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.model.assumed_noise import ReferenceNoise
from kreisel.model.standstill import Standstill
from kreisel.recording.recording import ReferencePoses
from kreisel.recording.recording_settings import ReferenceTable
from kreisel.synchronization.clock import Clock

_DEFAULTS = {
    "robot": (1e-3, 1e-3, 2e-4, 2e-4),
    "mocap": (1e-3, 3e-3, 1e-3, 3e-3),
}
"""m and rad: deviations of positions and orientations on the path, and of both at standstill, where none are stated.
Chosen: an arm is wrong by 1 mm and repeats a pose to 0.1 mm (docs/explanation/robot-errors.md); cameras are as good at
standstill as in motion; the passes correct them by the data."""


def assumed_noise(table: ReferenceTable, kind: str, reference: ReferencePoses) -> ReferenceNoise:
    """Return the noise that the settings state, with defaults for the kind of reference where they state none."""
    defaults = _DEFAULTS[kind]
    position = table.position_sd or defaults[0]
    orientation = table.orientation_sd or defaults[1]
    still_position = table.standstill_position_sd or min(position, defaults[2])
    still_orientation = table.standstill_orientation_sd or min(orientation, defaults[3])
    return ReferenceNoise(
        position=position,
        orientation=orientation,
        standstill_position=still_position,
        standstill_orientation=still_orientation,
        jitter_position=0.1 * still_position,
        jitter_orientation=0.1 * still_orientation,
        velocity=still_position,
        stamp=stamp_resolution(reference) / np.sqrt(12.0),
    )


def stamp_resolution(reference: ReferencePoses) -> float:
    """Return the step to which the reference's stamps were rounded, s; 0 where there is no such step.

    Stamps that are all multiples of a millisecond or more, while poses come at uneven steps of several
    such units, were rounded: the true time lies anywhere within the step.
    """
    steps = np.diff(reference.stamps_ns)
    unit = int(np.gcd.reduce(steps))
    if unit < 1_000_000 or np.unique(steps).size < 3 or float(np.median(steps)) < 2.5 * unit:
        return 0.0
    return unit * 1e-9


def with_measured_jitter(
    noise: ReferenceNoise, reference: ReferencePoses, standstills: tuple[Standstill, ...], clock: Clock
) -> ReferenceNoise:
    """Return the noise with the scatter of poses within standstills, where it exceeds what is assumed."""
    t_pose = clock.imu_time(reference.seconds)
    position, orientation = noise.jitter_position, noise.jitter_orientation
    scatter_p, scatter_q = [], []
    for standstill in standstills:
        within = slice(
            int(np.searchsorted(t_pose, standstill.start)), int(np.searchsorted(t_pose, standstill.stop, side="right"))
        )
        if within.stop - within.start < 5:
            continue
        if reference.positions is not None:
            scatter_p.append(float(np.mean(np.var(reference.positions[within], axis=0))))
        if reference.quaternions is not None:
            q = reference.quaternions[within]
            q = q * np.where(q @ q[0] < 0.0, -1.0, 1.0)[:, None]
            scatter_q.append(float(4.0 * np.sum(np.var(q, axis=0)) / 3.0))
    if scatter_p:
        position = max(position, float(np.sqrt(np.median(scatter_p))))
    if scatter_q:
        orientation = max(orientation, float(np.sqrt(np.median(scatter_q))))
    return replace(noise, jitter_position=position, jitter_orientation=orientation)

"""How good the reference is believed to be, and how the filter's own innovations correct that belief."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kreisel.geometry.rotation import Indices
from kreisel.recording import RecordingSettings, ReferencePoses


@dataclass(frozen=True)
class ReferenceNoise:
    """Standard deviations of the reference's poses (m, rad), velocity at rest (m/s) and stamps (s).

    At rest the error is one draw for the whole rest (`standstill_*`) plus a small scatter (`jitter_*`).
    """

    position: float
    orientation: float
    standstill_position: float
    standstill_orientation: float
    jitter_position: float
    jitter_orientation: float
    velocity: float
    stamp: float

    def scaled(self, position: float, orientation: float) -> ReferenceNoise:
        """Return the noise with position and orientation figures multiplied by factors."""
        return replace(
            self,
            position=self.position * position,
            orientation=self.orientation * orientation,
            standstill_position=self.standstill_position * position,
            standstill_orientation=self.standstill_orientation * orientation,
        )


_DEFAULTS = {
    "robot": (1e-3, 1e-3, 2e-4, 2e-4),
    "mocap": (1e-3, 3e-3, 1e-3, 3e-3),
}


def believed_noise(settings: RecordingSettings, reference: ReferencePoses) -> ReferenceNoise:
    """Return the noise the recording's settings state, with defaults where they state none."""
    table = settings.reference
    defaults = _DEFAULTS[table.kind or "robot"]
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
    """Return the step to which the reference's stamps were rounded, s; 0 where none shows.

    Stamps that are all multiples of a millisecond or more, while poses come at uneven steps of several
    such units, were rounded: the true moment lies anywhere within.
    """
    steps = np.diff(reference.stamps_ns)
    unit = int(np.gcd.reduce(steps))
    if unit < 1_000_000 or np.unique(steps).size < 3 or float(np.median(steps)) < 2.5 * unit:
        return 0.0
    return unit * 1e-9


def with_measured_jitter(noise: ReferenceNoise, reference: ReferencePoses, rests: list[Indices]) -> ReferenceNoise:
    """Return the noise with the scatter of poses within rests, where it exceeds what is assumed.

    Parameters
    ----------
    rests
        Indices of the poses in each rest.
    """
    position, orientation = noise.jitter_position, noise.jitter_orientation
    scatter_p, scatter_q = [], []
    for index in rests:
        if index.size < 5:
            continue
        if reference.positions is not None:
            scatter_p.append(float(np.mean(np.var(reference.positions[index], axis=0))))
        if reference.quaternions is not None:
            q = reference.quaternions[index]
            q = q * np.where(q @ q[0] < 0.0, -1.0, 1.0)[:, None]
            scatter_q.append(float(4.0 * np.sum(np.var(q, axis=0)) / 3.0))
    if scatter_p:
        position = max(position, float(np.sqrt(np.median(scatter_p))))
    if scatter_q:
        orientation = max(orientation, float(np.sqrt(np.median(scatter_q))))
    return replace(noise, jitter_position=position, jitter_orientation=orientation)

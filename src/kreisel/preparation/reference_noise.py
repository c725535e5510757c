"""Assumed noise of the reference before the filter runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.estimation.robust import vector_scale
from kreisel.geometry.rotation import Array, conjugate, lengths, log, multiply
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

_MUCH = 3.0
"""White noise over the default from which it replaces that. Chosen: the passes correct less, and what a robot's path
has of corners between its poses may look like noise of twice the default."""

_WINDOWS, _TAPS = 4_000, 6
"""Largest number of windows that show white noise, spread evenly over the poses, and poses in each. Chosen: they show
it to two per cent."""

_FEWEST = 100
"""Windows from which on they show it."""

_GAP, _BURST = 1.6, 0.5
"""Mean and shortest step of a window, in median steps, within which its poses count as evenly spread."""


def assumed_noise(table: ReferenceTable, kind: str, reference: ReferencePoses) -> ReferenceNoise:
    """Return the noise that the settings state; else what the poses show, or a default for the kind of reference."""
    defaults = _DEFAULTS[kind]
    pairs = zip(white_noise(reference), defaults[:2], strict=True)
    shown = [noise if noise > _MUCH * usual else usual for noise, usual in pairs]
    position = table.position_sd or shown[0]
    orientation = table.orientation_sd or shown[1]
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


def white_noise(reference: ReferencePoses) -> tuple[float, float]:
    """Return the deviations of white noise of positions, m, and orientations, rad; 0 where there are none.

    Notes
    -----
    Each pose differs from the cubic through the two before and the two after it by its own noise and theirs. Of
    neighbouring poses, noise makes these differences correlate negatively, and motion slower than a quarter of the rate
    of poses positively: a quarter of the variance of their difference less that of their sum is the noise alone.
    Variances are found by medians, so that corners of a path do not count.
    """
    t, count = reference.seconds, reference.seconds.size
    if count < _FEWEST:
        return 0.0, 0.0
    begins = np.unique(np.linspace(0, count - _TAPS, _WINDOWS).astype(np.int64))
    poses = begins[:, None] + np.arange(_TAPS)
    steps, usual = np.diff(t[poses], axis=1), reference.interval
    even = (steps.mean(axis=1) < _GAP * usual) & (steps.min(axis=1) > _BURST * usual)
    poses = poses[even]
    if len(poses) < _FEWEST:
        return 0.0, 0.0
    weights = [_from_cubic(t[part]) for part in (poses[:, :-1], poses[:, 1:])]
    shared = -np.sum(weights[0][:, 1:] * weights[1][:, :-1], axis=1)

    def noise_of(values: Array) -> float:
        first, second = (
            np.einsum("nj,njd->nd", weight, part) / np.sqrt(shared)[:, None]
            for weight, part in zip(weights, (values[:, :-1], values[:, 1:]), strict=True)
        )
        difference, total = (vector_scale(lengths(part)) for part in (first - second, first + second))
        return 0.5 * max(difference**2 - total**2, 0.0) ** 0.5

    p, q = reference.positions, reference.quaternions
    turned = None if q is None else log(multiply(conjugate(q[poses[:, 2]])[:, None], q[poses]).reshape(-1, 4))
    return (
        0.0 if p is None else noise_of(p[poses]),
        0.0 if turned is None else noise_of(turned.reshape(-1, _TAPS, 3)),
    )


def _from_cubic(t: Array) -> Array:
    """Return weights (n, 5) of values at times t (n, 5): the middle one's difference from the cubic of the others."""
    others, weights = (0, 1, 3, 4), np.ones(t.shape)
    for j in others:
        for i in others:
            if i != j:
                weights[:, j] *= (t[:, 2] - t[:, i]) / (t[:, j] - t[:, i])
    weights[:, others] *= -1.0
    return weights


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

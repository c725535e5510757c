"""Errors of reported poses that any reference may have: their scale, and the smoothing of what was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kreisel.geometry.rotation import Array, apply
from kreisel.inertial.sensor_model import correct_specific_force
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update

_WINDOW = 0.01
"""s; the angular acceleration is the change of the rate over so long before and behind."""


def pose_regressor(problem: Problem, known: CellParameters, updates: Sequence[Update], groups: Sequence[str]) -> Array:
    """Return the effect of groups on the poses of updates, (u, 6, e): the true poses less the reported.

    Rows: position in r, rotation as a right perturbation. `known`: parameters by which accelerations are computed.

    Notes
    -----
    The two of equation (24). A pose that is averaged over a symmetric window of variance 2 kappa is the true one plus
    kappa times its second derivative: of the position, and of the rotation vector away from it, to second order.
    """
    poses = np.array([update.pose for update in updates])
    samples = np.array([update.last for update in updates])
    columns = [_COLUMNS[group](problem, known, samples, poses) for group in groups]
    return np.stack(columns, axis=2) if columns else np.zeros((poses.size, 6, 0))


def _scale(problem: Problem, _known: CellParameters, _samples: Array, poses: Array) -> Array:
    out = np.zeros((poses.size, 6))
    positions = problem.reference.positions
    if positions is not None:
        out[:, :3] = positions.mean(axis=0) - positions[poses]
    return out


def _smoothing(problem: Problem, known: CellParameters, samples: Array, poses: Array) -> Array:
    quaternions = problem.reference.quaternions
    if quaternions is None:
        return np.zeros((poses.size, 6))
    f_b, alpha_b = _motion(problem, known, samples)
    gravity = apply(known.q_rn, np.array([0.0, 0.0, known.gravity]))
    return np.hstack([-(apply(quaternions[poses], f_b) + gravity), -alpha_b])


_COLUMNS = {"position_scale": _scale, "reference_smoothing": _smoothing}


def _motion(problem: Problem, known: CellParameters, samples: Array) -> tuple[Array, Array]:
    """Return the specific force and the angular acceleration of b, (u, 3) each, at samples."""
    readings, sensors = problem.sensor.readings, known.sensors
    width = max(1, round(_WINDOW / float(np.median(np.diff(readings.stamps[:1000])))))
    before, behind = np.maximum(samples - width, 0), np.minimum(samples + width, readings.stamps.size - 1)
    span = (readings.stamps[behind] - readings.stamps[before])[:, None]
    alpha = (readings.rates[behind] - readings.rates[before]) / span @ sensors.K_omega.T
    omega = (readings.rates[samples] + sensors.k_w[0]) @ sensors.K_omega.T
    return correct_specific_force(readings.accelerations[samples], omega, alpha, sensors), alpha

"""Reported poses: motion at a time by them, and errors that any reference may have (scale, smoothing)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import Array, apply
from kreisel.inertial.sensor_model import correct_specific_force
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update
from kreisel.recording.recording import ReferencePoses

_WINDOW = 0.01
"""s; the angular acceleration is the change of the rate over so long before and after."""


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
    return np.concatenate([np.zeros((poses.size, 6, 0)), *columns], axis=2)


def _scale(problem: Problem, _known: CellParameters, _samples: Array, poses: Array) -> Array:
    out = np.zeros((poses.size, 6, 1))
    positions = problem.reference.positions
    if positions is not None:
        out[:, :3, 0] = positions.mean(axis=0) - positions[poses]
    return out


def _smoothing(problem: Problem, known: CellParameters, samples: Array, poses: Array) -> Array:
    quaternions = problem.reference.quaternions
    if quaternions is None:
        return np.zeros((poses.size, 6, 1))
    f_b, alpha_b = _motion(problem, known, samples)
    gravity = apply(known.q_rn, np.array([0.0, 0.0, known.gravity]))
    return np.hstack([-(apply(quaternions[poses], f_b) + gravity), -alpha_b])[:, :, None]


_COLUMNS = {"position_scale": _scale, "reference_smoothing": _smoothing}


def _motion(problem: Problem, known: CellParameters, samples: Array) -> tuple[Array, Array]:
    """Return the specific force and the angular acceleration of b, (u, 3) each, at samples."""
    readings, sensors = problem.sensor.readings, known.sensors
    width = max(1, round(_WINDOW / float(np.median(np.diff(readings.stamps[:1000])))))
    before, after = np.maximum(samples - width, 0), np.minimum(samples + width, readings.stamps.size - 1)
    span = (readings.stamps[after] - readings.stamps[before])[:, None]
    alpha = (readings.rates[after] - readings.rates[before]) / span @ sensors.K_omega.T
    omega = (readings.rates[samples] + sensors.k_w[0]) @ sensors.K_omega.T
    return correct_specific_force(readings.accelerations[samples], omega, alpha, sensors), alpha


def pose_near(reference: ReferencePoses, at: float) -> tuple[Array, Array, Array]:
    """Return attitude, position and velocity at a reference time, by linear interpolation of the poses around it."""
    tau = reference.seconds
    k = int(np.clip(np.searchsorted(tau, at) - 1, 0, tau.size - 2))
    width = max(1, round(0.05 / float(np.median(np.diff(tau)))))
    low, high = max(k - width + 1, 0), min(k + width, tau.size - 1)
    share = (at - tau[k]) / (tau[k + 1] - tau[k])
    q, p, v = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    if reference.positions is not None:
        p = (1.0 - share) * reference.positions[k] + share * reference.positions[k + 1]
        v = (reference.positions[high] - reference.positions[low]) / (tau[high] - tau[low])
    if reference.quaternions is not None:
        q = slerp(reference.quaternions[k], reference.quaternions[k + 1], share)
    return q, p, v

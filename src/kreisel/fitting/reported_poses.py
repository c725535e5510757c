"""Reported poses: motion at a time by them, and errors of any reference (frame, smoothing, an elastic mount)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from kreisel.geometry.interpolation import slerp
from kreisel.geometry.rotation import Array, Indices, apply, matrix
from kreisel.inertial.sensor_model import correct_specific_force
from kreisel.model.parameters import CellParameters
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update
from kreisel.recording.recording import ReferencePoses

_WINDOW = 0.01
"""s; the angular acceleration is the change of the rate over so long before and after."""

_ENOUGH = 1000
"""Poses that show what a rigid mount would do. Chosen: a second apart in a recording of a quarter of an hour."""


def pose_regressor(problem: Problem, known: CellParameters, updates: Sequence[Update], groups: Sequence[str]) -> Array:
    """Return the effect of groups on the poses of updates, (u, 6, e): the true poses less the reported.

    Rows: position in r, rotation as a right perturbation. `known`: parameters by which accelerations are computed.

    Notes
    -----
    Those of equation (24). A pose that is averaged over a symmetric window of variance 2 kappa is the true one plus
    kappa times its second derivative: of the position, and of the rotation vector away from it, to second order.
    """
    poses = np.array([update.pose for update in updates])
    samples = np.array([update.last for update in updates])
    columns = [_COLUMNS[group](problem, known, samples, poses) for group in groups]
    return np.concatenate([np.zeros((poses.size, 6, 0)), *columns], axis=2)


def _scale(problem: Problem, _known: CellParameters, _samples: Indices, poses: Indices) -> Array:
    out = np.zeros((poses.size, 6, 1))
    positions = problem.reference.positions
    if positions is not None:
        out[:, :3, 0] = positions.mean(axis=0) - positions[poses]
    return out


def _heading(problem: Problem, known: CellParameters, _samples: Indices, poses: Indices) -> Array:
    out = np.zeros((poses.size, 6, 1))
    positions = problem.reference.positions
    if positions is not None:
        down = apply(known.q_rn, np.array([0.0, 0.0, 1.0]))
        out[:, :3, 0] = np.cross(positions[poses] - positions.mean(axis=0), down)
    return out


def _smoothing(problem: Problem, known: CellParameters, samples: Indices, poses: Indices) -> Array:
    quaternions = problem.reference.quaternions
    if quaternions is None:
        return np.zeros((poses.size, 6, 1))
    f_b, alpha_b = _motion(problem, known, samples)
    gravity = apply(known.q_rn, np.array([0.0, 0.0, known.gravity]))
    return np.hstack([-(apply(quaternions[poses], f_b) + gravity), -alpha_b])[:, :, None]


def _bending(problem: Problem, known: CellParameters, samples: Indices, poses: Indices) -> Array:
    def turns(f_b: Array, _C: Array) -> Array:
        return np.einsum("ik,uj->uikj", np.eye(3), f_b).reshape(-1, 3, 9)

    turn = _elastic(problem, known, (samples, poses), turns, lambda C: np.broadcast_to(np.eye(3), C.shape))
    return np.concatenate([np.zeros_like(turn), turn], axis=1)


def _deflection(problem: Problem, known: CellParameters, samples: Indices, poses: Indices) -> Array:
    def shifts(f_b: Array, C: Array) -> Array:
        return np.einsum("uik,uj->uikj", C, f_b).reshape(-1, 3, 9)

    def rigid(C: Array) -> Array:
        return np.concatenate([np.broadcast_to(np.eye(3), C.shape), C], axis=2)

    shift = _elastic(problem, known, (samples, poses), shifts, rigid)
    return np.concatenate([shift, np.zeros_like(shift)], axis=1)


def _elastic(
    problem: Problem,
    known: CellParameters,
    at: tuple[Indices, Indices],
    columns: Callable[[Array, Array], Array],
    rigid: Callable[[Array], Array],
) -> Array:
    """Return columns (u, 3, 9) of an elastic mount, without what another rigid mount or origin would do.

    So the other parameters are those of the rigid mount that fits best over the recording.

    Parameters
    ----------
    at
        Samples and poses of the updates, (u,) each.
    columns
        From specific forces of b (k, 3) and matrices of attitudes (k, 3, 3) to what units of the parameters do.
    rigid
        From those matrices to what units of another rigid mount or origin do, (k, 3, r).
    """
    reference, stamps = problem.reference, problem.sensor.readings.stamps
    if reference.quaternions is None:
        return np.zeros((at[0].size, 3, 9))
    quaternions = reference.quaternions

    def own_and_rigid(samples: Indices, poses: Indices) -> tuple[Array, Array]:
        C = matrix(quaternions[poses])
        return columns(_motion(problem, known, samples)[0], C), rigid(C)

    some = np.linspace(0, reference.seconds.size - 1, min(reference.seconds.size, _ENOUGH)).astype(np.int64)
    then = np.searchsorted(stamps, known.clock.imu_time(reference.seconds[some]))
    own, fixed = own_and_rigid(np.minimum(then, stamps.size - 1), some)
    share = np.linalg.lstsq(fixed.reshape(-1, fixed.shape[2]), own.reshape(-1, 9), rcond=None)[0]
    own, fixed = own_and_rigid(*at)
    return np.asarray(own - fixed @ share)


_COLUMNS = {
    "position_scale": _scale, "position_heading": _heading, "reference_smoothing": _smoothing,
    "mount_bending": _bending, "mount_deflection": _deflection,
}  # fmt: skip


def _motion(problem: Problem, known: CellParameters, samples: Indices) -> tuple[Array, Array]:
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

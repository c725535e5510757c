"""Errors of the reference that are linear in place, attitude or time, and what they do to the parameters.

A volume of cameras that is measured with a wand is too long by the wand's error, and not by the same along all axes; a
flat body of markers in it seems turned, by its attitude. Cameras on stands turn while these warm up. An arm whose
gears, zeros or tool err does so by smooth functions of its posture. Over a limited range such an error is linear, and
looks like another matrix or offset of the sensors: it does not average out, and no residual shows it. What the data do
not say of it is a part of the deviations.
"""

from __future__ import annotations

import math

import numpy as np

from kreisel.fitting.fit import Linearised
from kreisel.fitting.terms import POSE_ROWS, Terms
from kreisel.geometry.rotation import Array, matrix
from kreisel.model.assumed_noise import REACH
from kreisel.model.problem import Problem

LINEAR_ERRORS = "linear errors of the reference"
"""Name of what they contribute to the uncertainty."""

_DISTORTION = 0.5
"""Error of the scale of one axis of cameras, or of a shear, over that of all axes. Chosen: a wand's length is one
number, and the axes are compared by all its places."""

_OF_ENTRY = 3.0**-0.5
"""Deviation of the amplitude of an entry over that of a rotation: the squares of all nine entries add up to three."""

_TURNING = 5e-7
"""rad/s; rate at which a frame of cameras turns, about each axis. Chosen: 0.3 mrad in ten minutes, a third of a
millimetre of a metre between two cameras' stands."""

_ENTRIES = 27
"""Errors that are linear in attitude: nine entries of its matrix, in each component of a rotation."""

_SHAPES: tuple[Array, ...] = (
    np.diag([1.0, -1.0, 0.0]),
    np.diag([1.0, 1.0, -2.0]) / math.sqrt(3.0),
    np.eye(3)[[1, 0, 2]] - np.diag([0.0, 0.0, 1.0]),
    np.eye(3)[[2, 1, 0]] - np.diag([0.0, 1.0, 0.0]),
    np.eye(3)[[0, 2, 1]] - np.diag([1.0, 0.0, 0.0]),
)
"""Distortions without a change of volume: scales of axes against each other, and shears."""


def linear_columns(problem: Problem, linear: Linearised, frame_sd: tuple[float, float]) -> tuple[Array, Array]:
    """Return the effect of such errors on the state: of a deviation of each, (degrees, m), and of their mean, (…, 1).

    Parameters
    ----------
    linear
        The problem linearised about its fit.
    frame_sd
        Deviations of an arm's frames, m and rad; zeros for cameras.

    Notes
    -----
    By equation (40) of docs/explanation/model.md. The parameters are not corrected by the mean of the errors after the
    data: it counts as an error.
    """
    degrees, (fields, deviations) = problem.layout.degrees, _fields(problem, frame_sd)
    count, updates = deviations.size, len(fields)
    if not fields.any():
        return np.zeros((degrees, count)), np.zeros((degrees, 1))
    components = np.broadcast_to(np.eye(6), (updates, 6, 6))
    terms = Terms(
        np.ones((updates, 1)),
        np.zeros(count, dtype=np.int64),
        np.arange(count) + POSE_ROWS.stop,
        np.concatenate([components, fields * deviations], axis=2),
    )
    about = linear.about(terms)
    values, vectors = np.linalg.eigh(np.eye(count) + 0.5 * (about.information + about.information.T))
    root = (vectors / np.sqrt(values)) @ vectors.T
    score = about.score.copy()
    if fields[:, :3, 0].any():
        score[0] += deviations[0] * linear.fit.history.pull_of_unit
    effect, mean = np.zeros((degrees, count)), np.zeros((degrees, 1))
    effect[: len(about.change)] = about.change @ root
    mean[: len(about.change), 0] = about.change @ (root @ (root @ score))
    return effect, mean


def _fields(problem: Problem, frame_sd: tuple[float, float]) -> tuple[Array, Array]:
    """Return what unit errors do to the poses at the updates, (u, 6, m), and their deviations (m,).

    Their number depends on the kind of the reference alone. Errors of rotation are sums of the entries of the attitude:
    of an arm, whose errors depend on its posture, and of flat bodies of markers, as far as the cameras' volume is
    sheared. The frame of cameras turns at a constant rate.
    """
    poses = np.array([update.pose for update in problem.schedule.updates])
    reference, (length, angle) = problem.reference, frame_sd
    arm, scale = max(frame_sd) > 0.0, problem.noise.volume_sd
    if arm:
        scale = shape_sd = math.hypot(length / REACH, angle)
    else:
        shape_sd = angle = _DISTORTION * scale
    by_place, by_attitude, by_time = (np.zeros((poses.size, 6, k)) for k in (1 + len(_SHAPES), _ENTRIES, 3))
    if reference.quaternions is not None:
        q = reference.quaternions[poses]
        by_attitude[:, 3:] = _by_attitude(q)
        by_time[:, 3:] = matrix(q).transpose(0, 2, 1)
    if reference.positions is not None:
        p = reference.positions[poses] - reference.positions.mean(axis=0)
        if "position_scale" not in problem.layout:
            by_place[:, :3, 0] = p
        for k, shape in enumerate(_SHAPES, start=1):
            by_place[:, :3, k] = p @ shape
        by_time[:, :3] = np.cross(np.eye(3), p[:, None]).transpose(0, 2, 1)
    deviations = [scale, *[shape_sd] * len(_SHAPES), *[angle * _OF_ENTRY] * _ENTRIES]
    if arm:
        return np.concatenate([by_place, by_attitude], axis=2), np.array(deviations)
    seconds = reference.seconds[poses]
    by_time *= (seconds - seconds.mean())[:, None, None]
    turning = _TURNING if scale > 0.0 else 0.0
    return np.concatenate([by_place, by_attitude, by_time], axis=2), np.array([*deviations, *[turning] * 3])


def rotations_by_attitude(q: Array, angle: float) -> Array:
    """Return rotations (n, 3, 27) that are linear in the attitudes q (n, 4), one deviation each, of an angle in all."""
    return angle * _OF_ENTRY * _by_attitude(q)


def _by_attitude(q: Array) -> Array:
    """Return the entries of attitudes, from their mean, in each component of a rotation, (n, 3, 27)."""
    C = matrix(q).reshape(-1, 9)
    out = np.zeros((len(q), 3, _ENTRIES))
    for axis in range(3):
        out[:, axis, 9 * axis : 9 * axis + 9] = C - C.mean(axis=0)
    return out

"""The pose the reference should show."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

from kreisel._kernels.filter_arguments import Gaussian, Model
from kreisel._kernels.views import Array, Pointer, Stack, Table, TableView, for_columns, padded

from .compiled_parts import function


class Motion(NamedTuple):
    """What carries states on from the last sample of an interval, a column for each state.

    q_first (4, m), omega, alpha (3, m) and force (3, 3, m) as in `preintegration.Increments`; gravity and earth_rate
    (3, m), in r.
    """

    q_first: Table
    omega: Table
    alpha: Table
    force: Stack
    gravity: Table
    earth_rate: Table


_robot_motion = function("robot_motion", Pointer(Model), TableView, Pointer(Gaussian), TableView)
_predict_poses = function(
    "predict_poses", Pointer(Model), Pointer(Motion), TableView, ctypes.c_double, ctypes.c_double, TableView,
    ctypes.c_int64, TableView, TableView, TableView,
)  # fmt: skip


def predict_poses(
    model: Model, motion: Motion, t: Array, before: float, after: float, robot: Array, at_standstill: bool,
    states: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Return attitude (4, m) and position (3, m) the reference should show: equations (12) and (13).

    t (m,): seconds after the last sample, at most a sampling interval; before, after: sampling intervals on either side
    of it; robot (6, m): what its errors add to the nominal arm's pose, or (6, 0); states (size, m): at the last sample.
    """
    m = states.shape[1]
    q, p = for_columns(4, m), for_columns(3, m)
    columns = Motion(*(padded(part) for part in motion))
    moved = padded(robot) if robot.shape[1] else robot
    _predict_poses(model, columns, padded(t[None]), before, after, moved, int(at_standstill), padded(states), q, p)
    return q[:, :m], p[:, :m]


def robot_motion(model: Model, regressor: Array, belief: Gaussian) -> Array:
    """Return what the robot's errors add to the pose of the nominal arm, (6, 2 n + 1), of each sigma point.

    regressor (6, e): what a unit of each adds, by `Model.robot`; points in the order of `sigma_points.sample`.
    """
    out = for_columns(6, 2 * len(belief.upper) + 1)
    _robot_motion(model, regressor, belief, out)
    return out[:, : 2 * len(belief.upper) + 1]

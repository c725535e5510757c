"""A problem as the compiled filter reads it: see `_kernels.filter_arguments`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from kreisel._kernels import filter_arguments
from kreisel._kernels.compiled import check_order
from kreisel.estimation.sigma_points import LINEARISATIONS, USUAL, weights
from kreisel.estimation.state import StateLayout
from kreisel.geometry.rotation import Array, Indices, exp, multiply
from kreisel.inertial.effects import EFFECTS, groups_of, places_of
from kreisel.inertial.sensor_model import SizeEffect
from kreisel.inertial.strapdown import NOISE_STEP
from kreisel.model.assumed_noise import AssumedNoise, ColouredNoise
from kreisel.model.groups import group_named
from kreisel.model.layout import NAVIGATION, PATH_ERROR, STANDSTILL_ERROR, group_part
from kreisel.model.parameters import POSE_GROUPS, REFERENCE_GROUPS, ROBOT_GROUPS, CellParameters
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update

_NOISE: dict[str, Callable[[AssumedNoise], float]] = {
    "at_position": lambda noise: noise.coloured.white_factor * noise.reference.position,
    "at_orientation": lambda noise: noise.coloured.white_factor * noise.reference.orientation,
    "jitter_position": lambda noise: noise.reference.jitter_position,
    "jitter_orientation": lambda noise: noise.reference.jitter_orientation,
    "standstill_velocity": lambda noise: noise.reference.velocity,
}
_COLOURED: dict[str, Callable[[ColouredNoise], float]] = {
    "coloured_time": lambda noise: noise.time,
    "coloured_position": lambda noise: noise.position,
    "coloured_orientation": lambda noise: noise.orientation,
}
"""Figures by the names that the library has for them."""


def _places(order: Mapping[str, int]) -> dict[str, int]:
    """Return where groups begin if they stand one after another, in an order; effects, of any number, are last."""
    sizes = [0 if name.endswith("_effects") else group_part(name, 1).size for name in order]
    return dict(zip(order, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))


for _name, _own in (
    ("Stored", dict.fromkeys((part.name for part in (*NAVIGATION, *STANDSTILL_ERROR, *PATH_ERROR)), -1)),
    ("Noise", dict.fromkeys(_NOISE, -1)),
    ("Coloured", dict.fromkeys(_COLOURED, -1)),
    ("Gyro", _places(filter_arguments.GYRO)),
    ("Accel", _places(filter_arguments.ACCEL)),
    ("Around", _places(filter_arguments.AROUND)),
):
    check_order(_name, _own)


def filter_model(
    problem: Problem, known: CellParameters, points: str | None = None, varying: Indices | None = None
) -> filter_arguments.Model:
    """Return the model of a cell for the compiled filter; `known` has the values of groups not in the state.

    points: which sigma points, or one of `LINEARISATIONS`; those of the problem's settings by default. varying: see
    `filter_arguments.Model`.
    """
    layout, settings = problem.layout, problem.settings
    n = layout.degrees
    points = points or settings.sigma_points or USUAL
    w = weights(points, n)
    level, down = problem.site.earth_rate_units
    coloured = problem.noise.coloured
    walks = _walks(problem)

    def rows(groups: Sequence[str]) -> filter_arguments.ParameterRows:
        stored = {group: known.stored(group) for group in groups}
        source = [_rows_of(layout, group, value.size) for group, value in stored.items()]
        return filter_arguments.ParameterRows(np.concatenate(source), np.concatenate(list(stored.values())))

    sizes = effect_sizes(problem)
    gyro, accel = (groups_of(sizes, sensor) for sensor in ("gyroscope", "accelerometer"))

    def applied(groups: Sequence[str]) -> Array:
        return np.concatenate([np.zeros(0), *(known.stored(group) for group in groups)])

    return filter_arguments.Model(
        parts=layout.table,
        tail=layout.tail(problem.changing).table,
        sampled=np.array([row for row, part in zip(layout.table, layout, strict=True) if part.name not in POSE_GROUPS]),
        weights=np.array([getattr(w, figure) for figure in filter_arguments.WEIGHTS]),
        gyro=rows([*_but_effects(filter_arguments.GYRO), *gyro]),
        accel=rows([*_but_effects(filter_arguments.ACCEL), *accel]),
        around=rows(list(filter_arguments.AROUND)),
        robot=rows([*reference_groups(problem, known), *ROBOT_GROUPS]),
        gyro_degrees=problem.gyro_degrees,
        sensor_degrees=problem.sensor_degrees,
        stored=np.array([layout.stored(name).start if name in layout else -1 for name in filter_arguments.STORED]),
        gyro_effects=places_of(sizes, "gyroscope"),
        accel_effects=places_of(sizes, "accelerometer"),
        gyro_applied=applied(gyro),
        accel_applied=applied(accel),
        printed=settings.size_effect is SizeEffect.FOX2005,
        level=level,
        down=down,
        noise=np.array([_NOISE[name](problem.noise) for name in filter_arguments.NOISE]),
        standstill=np.array(problem.noise.standstill_error, dtype=float),
        coloured=np.array([_COLOURED[name](coloured) for name in filter_arguments.COLOURED]),
        walking=walks[:, 0].astype(np.int64),
        walk=walks[:, 1].copy(),
        fading=walks[:, 2].copy(),
        noise_step=NOISE_STEP,
        linear=LINEARISATIONS.get(points, 0),
        varying=np.zeros(0, dtype=np.int64) if varying is None else varying,
    )  # fmt: skip


def _rows_of(layout: StateLayout, group: str, size: int) -> Indices:
    """Return the rows of the stored state that hold a group's numbers, (size,); -1 for those that are known."""
    out = np.full(size, -1, dtype=np.int64)
    if group in layout:
        row = layout.stored(group)
        out[slice(None) if group_named(group).rotation else layout.present(group)] = np.arange(row.start, row.stop)
    return out


def _but_effects(order: Mapping[str, int]) -> list[str]:
    """Return the groups of an order, less the effects', which follow them."""
    return [group for group in order if not group.endswith("_effects")]


def _walks(problem: Problem) -> Array:
    """Return a row for each degree of freedom that walks, (w, 3): which, density, and rate of fading, 1/s."""
    noise = problem.noise
    of_groups = [(group, density, 0.0) for group, density in noise.offset_walk.items() if density > 0.0]
    of_groups += [
        (group, drift.size * (2.0 / drift.time) ** 0.5, 1.0 / drift.time) for group, drift in noise.gauss_markov.items()
    ]
    rows = [
        (i, density, rate)
        for group, density, rate in of_groups
        if group in problem.layout
        for i in range(problem.layout[group].start, problem.layout[group].stop)
    ]
    return np.array(rows).reshape(-1, 3)


def reference_groups(problem: Problem, known: CellParameters) -> tuple[str, ...]:
    """Return those of `REFERENCE_GROUPS` that are in the state, or have a known value other than zero."""
    return tuple(g for g in REFERENCE_GROUPS if g in problem.layout or known.stored(g).any())


def effect_sizes(problem: Problem) -> dict[str, int]:
    """Return the numbers of parameters of the sensors' effects that have some in the state, by group."""
    return {g: problem.layout.whole(g) for g in EFFECTS if g in problem.layout}


def filter_steps(
    problem: Problem, known: CellParameters, updates: Sequence[Update], reported: Array, about: Array | None = None
) -> filter_arguments.Steps:
    """Return some updates with the poses they use; reported: see `reported_poses.pose_regressor`.

    known: what a robot's errors are linear about. about: see `filter_arguments.Steps`; none by default.
    """
    reference = problem.reference
    poses = np.array([update.pose for update in updates])
    positions, quaternions = np.zeros((poses.size, 3)), np.zeros((poses.size, 4))
    if reference.positions is not None:
        positions = reference.positions[poses]
    if reference.quaternions is not None:
        quaternions = reference.quaternions[poses]
    regressor = reported
    if problem.robot is not None:
        zeros = known.robot.zeros
        robot = problem.robot.regressor(poses, zeros)
        regressor = np.concatenate([reported, robot], axis=2)
        if zeros.any():  # moved as by these zeros, and back by what the regressor makes of them
            shift, turn = problem.robot.moved_poses(poses, zeros)
            linear = robot[:, :, known.robot.part("robot_zeros")] @ zeros
            positions = positions + shift - linear[:, :3]
            quaternions = multiply(quaternions, multiply(turn, exp(-linear[:, 3:])))
    return filter_arguments.Steps(
        first=np.array([update.first for update in updates]),
        last=np.array([update.last for update in updates]),
        tau=np.array([update.tau for update in updates]),
        stamp=problem.noise.stamp_deviations(poses),
        at_standstill=np.array([update.standstill is not None for update in updates]),
        new_standstill=np.array([update.new_standstill for update in updates]),
        position=positions,
        quaternion=quaternions,
        given=np.array([reference.positions is not None, reference.quaternions is not None]),
        regressor=np.ascontiguousarray(regressor),
        about=np.empty((poses.size, 0)) if about is None else np.ascontiguousarray(about),
    )


def filter_record(problem: Problem, u: int, *, slopes: bool = False, varying: int = 0) -> filter_arguments.Record:
    """Return empty arrays for the record of u updates.

    slopes: with each update's transition, design and gain. varying: how many degrees of freedom's covariances are
    recorded, and the means with them.
    """
    m, n, k = filter_arguments.MEASURED, problem.layout.degrees, u if slopes else 0
    known = u if varying else 0
    return filter_arguments.Record(
        mean=np.empty((u, max((problem.layout.stored(group).stop for group in problem.groups), default=0))),
        deviation=np.empty((u, len(problem.parameter_names))),
        used=np.zeros(u, dtype=bool),
        nis=np.zeros(u),
        log_likelihood=np.empty(u),
        turn_information=np.empty(u),
        whitened=np.empty((u, m)),
        innovation=np.empty((u, m)),
        residual=np.empty((u, m)),
        noise_variance=np.empty((u, m)),
        passing=np.empty((u, 6)),
        late=np.empty((u, 2)),
        correction=np.empty((u, 6)),
        correction_variance=np.empty((u, 6)),
        transition=np.empty((k, problem.changing, n)),
        design=np.empty((k, m, n)),
        gain=np.empty((k, m, n)),
        whitening=np.empty((k, m, m)),
        before=np.empty((known, problem.layout.size)),
        covariance=np.empty((known, varying, n)),
    )

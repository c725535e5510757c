"""Named effects that are not in a problem's state, as terms of its readings and poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kreisel._kernels.filter_arguments import Samples
from kreisel.fitting.fit import Fit
from kreisel.fitting.reported_poses import pose_regressor
from kreisel.fitting.terms import OFFSET_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array, Indices, matrix
from kreisel.inertial.effects import EFFECTS, groups_of
from kreisel.inertial.strapdown import InertialSignal
from kreisel.model.layout import group_part
from kreisel.model.parameters import ROBOT_GROUPS
from kreisel.model.problem import Problem

OFFSET_OF = {"gyroscope": "gyro_offset", "accelerometer": "accel_offset"}
"""The offsets that effects of sensors are terms of."""

_BASE_RATES, _BASE_FORCES = 4, 3
"""Features of a prepared signal before those of effects; see `filter_arguments.Samples`."""


def named_terms(problem: Problem, run: Fit, groups: tuple[str, ...]) -> tuple[Terms, Array]:
    """Return terms for effects of some groups, and how many of each (m, c) a unit of each parameter is.

    Parameters
    ----------
    run
        A fit of the problem, whose parameters the effects of poses are linear about.
    groups
        Not in the problem's state; the offsets of their sensors are.
    """
    order = max(problem.settings.polynomial_order, 2)
    sizes = {group: group_part(group, order, problem.joints).degrees for group in groups}
    begin = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    updates = problem.schedule.updates
    means, moments = _over_updates(problem, run, {g: n for g, n in sizes.items() if g in EFFECTS})
    function, row, parameter = [], [], []
    at = 0
    for sensor, offset in OFFSET_OF.items():
        for group in groups_of(sizes, sensor):
            places = EFFECTS[group].places(sizes[group])
            for feature, axis in zip(*np.nonzero(places >= 0), strict=True):
                function.append(at + int(feature))
                row.append(OFFSET_ROWS[offset][axis])
                parameter.append(begin[group] + int(places[feature, axis]))
            at += len(places)
    directions = [np.broadcast_to(np.eye(len(POSE_ROWS)), (len(updates), 6, 6))]
    for group, columns in _of_poses(problem, run, groups):
        first = POSE_ROWS.start + sum(one.shape[2] for one in directions)
        directions.append(columns)
        for i in range(sizes[group]):
            function.append(at)
            row.append(first + i)
            parameter.append(begin[group] + i)
    ones = np.ones((len(updates), 1))
    combined = np.zeros((len(row), sum(sizes.values())))
    combined[np.arange(len(row)), parameter] = 1.0
    terms = Terms(
        np.hstack([means, ones]), np.array(function, dtype=np.int64), np.array(row, dtype=np.int64),
        np.concatenate(directions, axis=2), np.hstack([moments, 0.0 * ones]), axes_in_r(problem, run),
    )  # fmt: skip
    return terms, combined


def axes_in_r(problem: Problem, run: Fit) -> Array:
    """Return what a unit of each accelerometer's reading is in r, in the middle between two updates, (u, 3, 3)."""
    updates, given = problem.schedule.updates, problem.reference.quaternions
    attitude = problem.schedule.attitude if given is None else given[[update.pose for update in updates]]
    at_end = matrix(attitude)
    at_begin = np.concatenate([at_end[:1], at_end[:-1]])
    at_begin = np.where([[[update.new_segment]] for update in updates], at_end, at_begin)
    return np.asarray(0.5 * (at_begin + at_end) @ run.parameters.sensors.K_a)


def _of_poses(problem: Problem, run: Fit, groups: tuple[str, ...]) -> Iterator[tuple[str, Array]]:
    """Yield groups of reference and robot with their effect on the poses of updates, (u, 6, e)."""
    updates, known = problem.schedule.updates, run.parameters
    robot = None
    for group in groups:
        if group in EFFECTS:
            continue
        if group not in ROBOT_GROUPS:
            yield group, pose_regressor(problem, known, updates, (group,))
        elif problem.robot is not None:
            if robot is None:
                robot = problem.robot.regressor(np.array([update.pose for update in updates]), known.robot.zeros)
            yield group, robot[:, :, known.robot.part(group)]


def _over_updates(problem: Problem, run: Fit, sizes: dict[str, int]) -> tuple[Array, Array]:
    """Return features of effects (u, k), on average since the update before, and their moments (u, k)."""
    updates = problem.schedule.updates
    first, last = (np.array([getattr(update, name) for update in updates]) for name in ("first", "last"))
    readings = problem.sensor.readings.with_effects(sizes, run.parameters.sensors.effects)
    stamps, joint = problem.sensor.readings.stamps, 0
    sums: list[Array] = []
    for signal in readings.chunks():
        end = signal.begin + signal.stamps.size - 1
        low, high = np.clip(first, joint, end), np.clip(last, joint, end)
        own = np.flatnonzero(high > low)
        if not sums:
            sums = [np.zeros((len(updates), n)) for n in _counts(signal)]
        for total, added in zip(sums, _sums(signal, joint, low[own], high[own], stamps[last[own]]), strict=True):
            total[own] += added
        joint = end
    of_rates, of_forces, weighted = sums
    seconds = np.maximum(stamps[last] - stamps[first], 1e-9)[:, None]
    moments = weighted - 0.5 * of_forces * seconds
    return np.hstack([of_rates, of_forces]) / seconds, np.hstack([0.0 * of_rates, moments])


def _counts(signal: InertialSignal) -> tuple[int, int, int]:
    """Return the numbers of features of effects of the gyros and, twice, of the accelerometers."""
    forces = len(signal.samples.forces) - _BASE_FORCES
    return len(signal.samples.integrals) - _BASE_RATES, forces, forces


def _sums(signal: InertialSignal, joint: int, low: Indices, high: Indices, end: Array) -> Iterator[Array]:
    """Yield integrals (u, k), from samples `low` to `high`, which is larger, of features of gyros and accelerometers.

    Then those of the accelerometers' times the seconds that are left until the times `end` (u,).
    """
    samples: Samples = signal.samples
    edges = np.column_stack([low, high]).ravel() - joint

    def between(values: Array) -> Array:
        inner = edges[edges < values.shape[1]]  # only the last may be the end: a sum begins at each
        return np.asarray(np.add.reduceat(values, inner, axis=1)[:, ::2].T) if edges.size else values[:, :0].T

    part = slice(joint - signal.begin, None)
    yield between(samples.integrals[_BASE_RATES:, part])
    stamps = samples.stamps[part]
    forces = samples.forces[_BASE_FORCES:, part]
    middle = 0.5 * (forces[:, 1:] + forces[:, :-1]) * np.diff(stamps)
    yield between(middle)
    until = np.append(np.repeat(end, np.diff(high - joint, prepend=0)), np.zeros(stamps.size - 1))[: stamps.size - 1]
    middle *= until - 0.5 * (stamps[1:] + stamps[:-1])
    yield between(middle)

"""Named effects that are not in a problem's state, as terms of its readings and poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.fitting.reported_poses import pose_regressor
from kreisel.fitting.terms import OFFSET_ROWS, POSE_ROWS, Terms
from kreisel.geometry.rotation import Array, Indices, matrix
from kreisel.inertial.effects import EFFECTS, features_of, groups_of
from kreisel.model.layout import group_part
from kreisel.model.parameters import ROBOT_GROUPS
from kreisel.model.problem import Problem

OFFSET_OF = {"gyroscope": "gyro_offset", "accelerometer": "accel_offset"}
"""The offsets that effects of sensors are terms of."""


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
    means, moments = _over_updates(problem, {g: n for g, n in sizes.items() if g in EFFECTS})
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


def has_offsets(problem: Problem, group: str) -> bool:
    """Return whether all offsets of a sensor are estimated; what is added to known ones has no slope in a fit."""
    return group in problem.layout and problem.layout.present(group).size == problem.layout.whole(group)


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


def _over_updates(problem: Problem, sizes: dict[str, int]) -> tuple[Array, Array]:
    """Return features of effects (u, k), on average since the update before, and their moments (u, k)."""
    updates, readings = problem.schedule.updates, problem.sensor.readings
    first, last = problem.schedule.samples
    counts = [sum(len(EFFECTS[g].places(sizes[g])) for g in groups_of(sizes, sensor)) for sensor in OFFSET_OF]
    integrals, weighted = np.zeros((len(updates), sum(counts))), np.zeros((len(updates), counts[1]))
    for chunk in readings.raw_chunks():
        low, high = (np.clip(edge, chunk.first, chunk.last) for edge in (first, last))
        own = np.flatnonzero(high > low)
        if own.size == 0:
            continue
        edges = low[own] - chunk.first, high[own] - chunk.first
        of_rates, of_forces = (features_of(chunk.readings, sizes, sensor) for sensor in OFFSET_OF)
        integrals[own, : counts[0]] += _sums(chunk.integrals(of_rates), *edges)
        stamps, of_forces = chunk.own(chunk.readings.stamps[None])[0], chunk.own(of_forces)
        between = of_forces[:, 1:] + of_forces[:, :-1]
        between *= 0.5 * np.diff(stamps)
        integrals[own, counts[0] :] += _sums(between, *edges)
        until = np.zeros(stamps.size - 1)
        for begin, end, second in zip(*edges, readings.stamps[last[own]], strict=True):
            until[begin:end] = second
        between *= until - 0.5 * (stamps[1:] + stamps[:-1])
        weighted[own] += _sums(between, *edges)
    seconds = np.maximum(readings.stamps[last] - readings.stamps[first], 1e-9)[:, None]
    moments = weighted - 0.5 * integrals[:, counts[0] :] * seconds
    return integrals / seconds, np.hstack([np.zeros((len(updates), counts[0])), moments])


def _sums(values: Array, begin: Indices, end: Indices) -> Array:
    """Return the sums (u, k) of values (k, n) from some places to others, which are larger."""
    edges = np.column_stack([begin, end]).ravel()
    inner = edges[edges < values.shape[1]]  # only the last may be the end: a sum begins at each
    return np.asarray(np.add.reduceat(values, inner, axis=1)[:, ::2].T)

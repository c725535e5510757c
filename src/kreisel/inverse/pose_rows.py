"""Reported poses less those of a smooth motion, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.fitting.reported_poses import pose_regressor
from kreisel.geometry.pose_spline import PoseSpline, motion_at
from kreisel.geometry.rotation import Array, Indices, Mask, conjugate, exp, log, multiply
from kreisel.inverse.normal_equations import POINT, WIDTH, Rows
from kreisel.inverse.unknowns import Unknowns
from kreisel.kalman.kernel_inputs import filter_steps, reference_groups
from kreisel.model.parameters import ROBOT_GROUPS
from kreisel.model.problem import Problem
from kreisel.model.schedule import Update


def pose_rows(unknowns: Unknowns, spline: PoseSpline, used: Mask) -> list[Rows]:
    """Return the rows of the poses of used updates (u,), and of velocities at standstill, which are zero.

    Coloured errors of a reference on the path are taken as white ones that say as much of a mean.
    """
    problem, known = unknowns.problem, unknowns.known
    updates = problem.schedule.updates
    stamps = problem.sensor.readings.stamps
    own = [update for update, kept in zip(updates, used, strict=True) if kept]
    groups = reference_groups(problem, known)
    steps = filter_steps(problem, known, own, pose_regressor(problem, known, own, groups))
    tau = steps.tau
    samples = stamps[steps.last]  # near the poses, and the same whatever the clocks are
    end = spline.begin + spline.spacing * spline.spans
    at = known.clock.imu_time(tau) + unknowns.walked_clock(samples)
    inside = (at >= spline.begin) & (at <= end)
    at = np.clip(at, spline.begin, end)
    motion = motion_at(spline, at)
    standstill = _numbers(updates, own)

    robot = ROBOT_GROUPS if problem.robot is not None else ()
    errors, places = _errors(unknowns, (*groups, *robot))
    reported = steps.regressor @ errors
    still = np.zeros((len(own), 6))
    still[standstill >= 0] = unknowns.still[standstill[standstill >= 0]]
    position = steps.position - (motion.p + still[:, :3] - reported[:, :3])
    attitude = multiply(multiply(motion.q, exp(still[:, 3:])), exp(-reported[:, 3:]))
    turn = log(multiply(conjugate(attitude), steps.quaternion))
    residual = np.concatenate([position, turn], axis=1)

    u, n = len(own), len(problem.parameter_names)
    by_points = np.zeros((u, 6, WIDTH // POINT, POINT))
    by_points[:, :3, :, 3:] = np.einsum("uk,xy->uxky", motion.weights[0], np.eye(3))
    by_points[:, 3:, :, :3] = np.moveaxis(motion.turn, 1, 2)
    by_parameters = np.zeros((u, 6, n))
    by_parameters[:, :, places[places >= 0]] = -steps.regressor[:, :, places >= 0]
    moving = np.concatenate([motion.v, motion.omega], axis=1)
    layout = problem.layout
    for group, factor in (("time_offset", np.ones(u)), ("time_skew", tau)):
        if group in layout:
            by_parameters[:, :, layout[group].start] = factor[:, None] * moving
    weight = 1.0 / _deviations(problem, own, moving, spacing=float(np.median(np.diff(samples))))
    weight[~inside] = 0.0
    rows = _Parts(
        samples, spline.span_of(at)[0], by_points.reshape(u, 6, WIDTH), by_parameters, residual, weight, standstill
    )
    resting = stamps[[update.last for update in updates if update.standstill is not None]]
    return [*_by_interval(unknowns, rows), *_still_rows(unknowns, spline, resting)]


def _numbers(updates: Sequence[Update], own: Sequence[Update]) -> Indices:
    """Return the numbers of the standstills that some updates lie in, counted from zero; -1 on the path."""
    places = {name: i for i, name in enumerate(sorted({u.standstill for u in updates if u.standstill is not None}))}
    return np.array([-1 if u.standstill is None else places[u.standstill] for u in own], dtype=np.int64)


def _errors(unknowns: Unknowns, groups: Sequence[str]) -> tuple[Array, Indices]:
    """Return errors of the reported poses, (e,), and which parameter each is, -1 for known ones."""
    layout = unknowns.problem.layout
    values, places = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    for group in groups:
        stored = unknowns.known.stored(group)
        own = np.full(stored.size, -1, dtype=np.int64)
        if group in layout:
            own[layout.present(group)] = np.arange(layout[group].start, layout[group].stop)
        values.append(stored)
        places.append(own)
    return np.concatenate(values), np.concatenate(places)


def _deviations(problem: Problem, updates: Sequence[Update], moving: Array, spacing: float) -> Array:
    """Return the deviations of poses, (u, 6)."""
    noise, coloured = problem.noise.reference, problem.noise.coloured
    lasting = 1.0
    if coloured.time > 0.0:
        kept = np.exp(-spacing / coloured.time)
        lasting = (1.0 + kept) / (1.0 - kept)
    out = np.zeros((len(updates), 6))
    stamps = problem.noise.stamp_deviations(np.array([update.pose for update in updates]))
    for i, update in enumerate(updates):
        for kind, part in enumerate((slice(0, 3), slice(3, 6))):
            if update.standstill is not None:
                out[i, part] = (noise.jitter_position, noise.jitter_orientation)[kind]
                continue
            white = coloured.white_factor * (noise.position, noise.orientation)[kind]
            own = (coloured.position, coloured.orientation)[kind] if coloured.time > 0.0 else 0.0
            out[i, part] = np.sqrt(white**2 + lasting * own**2 + (stamps[i] * moving[i, part]) ** 2)
    return out


@dataclass(frozen=True)
class _Parts:
    """Rows (u, r) at some seconds (u,), with their spans, weights and numbers of standstills, -1 for none."""

    seconds: Array
    span: Indices
    by_points: Array
    by_parameters: Array
    residual: Array
    weight: Array
    standstill: Indices


def _by_interval(unknowns: Unknowns, of: _Parts) -> list[Rows]:
    """Return rows for each interval of what walks, and each standstill."""
    order = np.argsort(of.span, kind="stable")
    interval = np.array([unknowns.interval_of(float(t)) for t in of.seconds])
    keys = np.column_stack([interval, of.standstill])[order]
    out = []
    for key in np.unique(keys, axis=0):
        own = order[(keys == key).all(axis=1)]
        at, number = int(key[0]), int(key[1])
        local = unknowns.spread(of.by_parameters[own], at, of.seconds[own])
        if number >= 0:
            local = np.concatenate([local, np.broadcast_to(np.eye(6), (own.size, 6, 6))], axis=2)
        w = of.weight[own]
        columns = unknowns.local(at, None if number < 0 else number)
        out.append(
            Rows(of.span[own], of.by_points[own] * w[:, :, None], local * w[:, :, None], of.residual[own] * w, columns)
        )
    return out


def _still_rows(unknowns: Unknowns, spline: PoseSpline, seconds: Array) -> list[Rows]:
    seconds = seconds[(seconds >= spline.begin) & (seconds <= spline.begin + spline.spacing * spline.spans)]
    count = seconds.size
    if count == 0:
        return []
    motion = motion_at(spline, seconds)
    by_points = np.zeros((count, 3, WIDTH // POINT, POINT))
    by_points[:, :, :, 3:] = np.einsum("uk,xy->uxky", motion.weights[1], np.eye(3))
    nothing = np.zeros((count, 3, len(unknowns.problem.parameter_names)))
    weight = np.full((count, 3), 1.0 / unknowns.problem.noise.reference.velocity)
    span, _ = spline.span_of(seconds)
    path = np.full(count, -1, dtype=np.int64)
    return _by_interval(
        unknowns, _Parts(seconds, span, by_points.reshape(count, 3, WIDTH), nothing, -motion.v, weight, path)
    )

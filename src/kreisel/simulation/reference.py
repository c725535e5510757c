"""A simulated reference: its clock, and how it takes, averages and reports poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kreisel.geometry.rotation import Array, apply, conjugate, exp, log, matrix, multiply
from kreisel.recording.recording import JointAngles, ReferencePoses
from kreisel.robot.motion import Timeline
from kreisel.simulation.cell_settings import Cell, Reference
from kreisel.simulation.controller import Report, reported
from kreisel.simulation.device_errors import middle
from kreisel.simulation.random_physics import RandomPhysics

START_NS = 1_000_000_000_000
"""Stamp of the first reading."""

MARGIN = 0.06
"""Seconds of IMU readings before the first pose and after the last."""

_WRONG = 0.02
"""m and rad: size of an outlier."""

_UNSEEN, _SWAPPED = 0.3, 2.0 * np.pi / 3.0
"""s for which cameras do not see the body, or take it for a turned one, and rad of that turn."""

Measure = Callable[[Array], Report]


@dataclass(frozen=True)
class ReferenceDraws:
    """Random streams of the reference: of path and repeatability, jitter and losses, clock, outliers and repeats."""

    path: np.random.Generator
    jitter: np.random.Generator
    clock: np.random.Generator
    faults: np.random.Generator


def with_heading(reference: ReferencePoses, angle: float, gravity: Array) -> ReferencePoses:
    """Return poses whose positions are turned about gravity (3,) by an angle, as of another device's frame."""
    if not angle or reference.positions is None:
        return reference
    down = gravity / np.linalg.norm(gravity)
    return replace(reference, positions=apply(exp(angle * down), reference.positions))


def report_poses(
    cell: Cell, planned: Timeline, measure: Measure, draws: ReferenceDraws, path: Path, physics: RandomPhysics
) -> tuple[ReferencePoses, JointAngles | None]:
    """Return poses and joint angles on the reference's own clock.

    Parameters
    ----------
    measure
        From times (n,) to what the reference measures then.
    physics
        Errors that are on no list.
    """
    r = cell.reference
    skew = r.clock_drift_ppm * 1e-6
    last = min(cell.seconds, planned.seconds)
    pace = 1.0 if r.clock_is_true else 1.0 + skew  # true seconds in one of the reference's
    tau = np.arange(0.0, (last - 2.0 * MARGIN) / pace, r.interval)
    kept = draws.jitter.uniform(size=tau.size) >= r.drop_share
    kept[[0, -1]] = True
    tau = tau[kept]
    t = MARGIN + pace * tau
    late = r.jitter * draws.jitter.normal(size=t.size) + _clock_error(draws.clock, r, t, last) + physics.lateness(t)
    taken = _interpolated(_averaged(measure, r.smoothing), r.interpolation)
    p, q, angles = reported(draws.path, taken, planned, t, late, cell.errors)
    p, q = physics.poses(r.kind, t, p, q, angles)
    p, q, angles = _faulty(draws.faults, r, (p, q, angles))
    p, q = _lost_from_view(draws.faults.spawn(1)[0], r, t, p, q)
    p, q = _by_cameras(draws.faults.spawn(1)[0], r, t, p, q)
    stamps = START_NS + np.round((tau + MARGIN - r.clock_offset) * 1e9).astype(np.int64)
    if cell.motion.still_poses:
        still = planned.at_rest(t, 0.5 * planned.smoothing)  # the averaged set points stand, too
        stamps, p, q, angles = stamps[still], p[still], q[still], angles[still]
    name = "pose0"
    reference = ReferencePoses(
        name,
        stamps,
        p * (1.0 + 1e-6 * r.position_scale_ppm) if r.measures != "orientation" else None,
        q if r.measures != "position" else None,
        path / name / "data.csv",
    )
    with_joints = r.joints and r.kind == "robot"
    joints = JointAngles(stamps, angles, path / "joint0" / "data.csv") if with_joints else None
    return reference, joints


def _clock_error(rng: np.random.Generator, r: Reference, t: Array, last: float) -> Array:
    """Return by how much later poses are measured than the clocks' constant offset and ratio say, (n,), s."""
    jump, walk = middle(rng, last), np.cumsum(rng.normal(size=t.size) * np.sqrt(np.diff(t, prepend=t[0])))
    return r.clock_jump * (t >= jump) + r.clock_walk * walk


def _by_cameras(rng: np.random.Generator, r: Reference, t: Array, p: Array, q: Array) -> tuple[Array, Array]:
    """Return poses (n, 3) and (n, 4) of a flat body of markers in a distorted volume whose frame turns.

    The markers lie in the plane of the body's x and y, with the same spread along both; the body is fitted to where
    they are seen. Its frame, and that of the cameras, are those with which it seems turned least.
    """
    if not (r.distortion or r.turning):
        return p, q
    axes, shears = rng.normal(size=3), rng.normal(size=3)
    D = np.diag(axes - axes.mean())
    D[[0, 0, 1], [1, 2, 2]] = D[[1, 2, 2], [0, 0, 1]] = shears
    D *= r.distortion
    C = matrix(q)
    spread = C @ np.diag([1.0, 1.0, 0.0]) @ C.transpose(0, 2, 1)
    seen = D @ spread
    torque = np.stack([seen[:, k, j] - seen[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    turn = np.einsum("nji,nj->ni", C, np.linalg.solve(inertia, torque[..., None])[..., 0])
    frames = np.concatenate([np.broadcast_to(np.eye(3), C.shape), C.transpose(0, 2, 1)], axis=2).reshape(-1, 6)
    turn -= (frames @ np.linalg.lstsq(frames, turn.ravel(), rcond=None)[0]).reshape(-1, 3)
    turned = exp((t - t[0])[:, None] * r.turning * rng.normal(size=3))
    return apply(turned, p + p @ D), multiply(turned, multiply(q, exp(turn)))


def _averaged(measure: Measure, sd: float) -> Measure:
    """Return the mean over a window of constant weight, its standard deviation sd, by Gauss-Legendre quadrature."""
    if sd <= 0.0:
        return measure
    nodes, weights = np.polynomial.legendre.leggauss(7)

    def mean(t: Array) -> Report:
        _, centre, _ = measure(t)
        p, turn, angles = 0.0, 0.0, 0.0
        for x, weight in zip(np.sqrt(3.0) * sd * nodes, 0.5 * weights, strict=True):
            position, q, joints = measure(t + x)
            p, angles = p + weight * position, angles + weight * joints
            turn = turn + weight * log(multiply(conjugate(centre), q))
        return np.asarray(p), multiply(centre, exp(np.asarray(turn))), np.asarray(angles)

    return mean


def _interpolated(measure: Measure, interval: float) -> Measure:
    """Return poses that are measured once an interval, and on a straight line between."""
    if interval <= 0.0:
        return measure

    def straight(t: Array) -> Report:
        first = np.floor(t.min() / interval)
        ticks = interval * np.arange(first, np.floor(t.max() / interval) + 2.0)
        p, q, angles = measure(ticks)
        k = np.clip(np.floor(t / interval - first).astype(int), 0, ticks.size - 2)
        share = (t / interval - first - k)[:, None]
        turn = log(multiply(conjugate(q[k]), q[k + 1]))
        return (
            p[k] + share * (p[k + 1] - p[k]),
            multiply(q[k], exp(share * turn)),
            angles[k] + share * (angles[k + 1] - angles[k]),
        )

    return straight


def _faulty(rng: np.random.Generator, r: Reference, report: Report) -> Report:
    """Return a report with outliers, and with poses that repeat the one before."""
    p, q, angles = report
    n = len(p)
    wrong, held = rng.uniform(size=(2, n))
    directions = rng.normal(size=(2, n, 3))
    directions /= np.linalg.norm(directions, axis=2)[:, :, None]
    size = np.where(wrong < r.outlier_share, _WRONG, 0.0)[:, None]
    if r.outlier_share > 0.0:
        p, q = p + size * directions[0], multiply(q, exp(size * directions[1]))
    repeats = held < r.held
    repeats[0] = False
    last = np.maximum.accumulate(np.where(repeats, 0, np.arange(n)))
    return p[last], q[last], angles[last]


def _lost_from_view(rng: np.random.Generator, r: Reference, t: Array, p: Array, q: Array) -> tuple[Array, Array]:
    """Return poses of cameras that now and then do not see the body, or take its markers for each other."""
    p, q = p.copy(), q.copy()
    for begin in t[0] + (t[-1] - t[0]) * rng.uniform(0.1, 0.9, r.frozen):
        own = np.flatnonzero((t >= begin) & (t < begin + _UNSEEN))
        p[own], q[own] = p[own[0]], q[own[0]]
    for begin in t[0] + (t[-1] - t[0]) * rng.uniform(0.1, 0.9, r.swapped):
        own = np.flatnonzero((t >= begin) & (t < begin + _UNSEEN))
        axis = rng.normal(size=3)
        q[own] = multiply(q[own], exp(_SWAPPED * axis / np.linalg.norm(axis)))
    return p, q

"""The older static method by robot: standstills at poses, gravity in known attitudes, turns between them.

After Fox and Janocha (2004). What it needs of the reference is its orientations at standstill; clocks count little.
"""

from __future__ import annotations

import time

import numpy as np

from kreisel.calibration.linear_errors import rotations_by_attitude
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices, conjugate, exp, log, multiply
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.parameters import ROBOT_GROUPS, RobotParameters
from kreisel.model.robot_model import RobotModel
from kreisel.preparation.build_problem import frame_sd_of
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.prepare import prepare_recording
from kreisel.preparation.start_values import starting_point
from kreisel.progress import Progress
from kreisel.recording.recording import DataWarning, Recording, ReferencePoses
from kreisel.static.first_values import MIN_ATTITUDES
from kreisel.static.pose_attitudes import PoseAttitudes
from kreisel.static.rest_problem import RestProblem, raw_of
from kreisel.static.rest_search import find_rests
from kreisel.static.rests import Rests
from kreisel.static.static_methods import Chosen
from kreisel.static.static_result import StaticOutcome, concluded
from kreisel.tasks import Executor, sequential

METHOD = "static"
"""Name of the method in the result file, and of `calibrate --method`."""

_NO_ARM = (
    "its errors cannot be estimated without joint angles and robot.urdf: deviations contain an attitude of the tool "
    "that errs as much as the poses differ, or by robot.angle_sd"
)

_MOVED = 2e-3
"""rad: change of the reported attitude within a standstill, from beginning to end, beyond which it is none."""

_NOTHING = 1e-9
"""rad: effect on attitudes from which on an error of the robot counts; lengths have none."""


def calibrate_by_robot(
    recording: Recording, settings: CalibrationSettings, progress: Progress | None = None,
    executor: Executor = sequential,
) -> StaticOutcome:  # fmt: skip
    """Return the calibration by standstills at poses alone.

    Raises
    ------
    RecordingError, SynchronizationError
        If reference and IMU do not belong together, there are no orientations, or too few standstills.
    """
    began = time.perf_counter()
    prepared = prepare_recording(recording, settings, executor)
    reference = prepared.reference
    if reference.quaternions is None:
        raise RecordingError("has positions alone; the static method needs orientations", file=reference.source)
    start, _ = starting_point(prepared, 1)
    imu = prepared.recording.imu
    rests, q, which = _at_poses(find_rests(imu), imu.seconds, prepared)
    if rests.count < MIN_ATTITUDES:
        raise RecordingError(
            f"{rests.count} standstills with poses, expected {MIN_ATTITUDES} or more: let the robot stop for two "
            "seconds or more in a dozen attitudes, or leave out --method", file=recording.path,
        )  # fmt: skip
    angle = frame_sd_of(prepared)[1]
    robot = prepared.robot
    effect, width = _linear(q, angle) if robot is None else _robot(robot, which)
    known = PoseAttitudes(np.arange(rests.count), q, start.q_rn, effect, width)
    problem = RestProblem(imu, raw_of(imu), rests, prepared.site, known=(known,), own_frame=False)
    start = problem.room(start)
    said = (*prepared.warnings, *([DataWarning("robot", _NO_ARM)] if angle else []))
    chosen = Chosen(METHOD, problem, start, known.attitudes(start), said, prepared.time_base_sd, angle)
    return concluded(recording, chosen, settings.only, progress, began)


def _at_poses(rests: Rests, t: Array, prepared: Preparation) -> tuple[Rests, Array, Indices]:
    """Return standstills with poses that do not change, their mean attitudes (M, 4), and one pose of each (M,)."""
    reference, clock = prepared.reference, prepared.rate_fit.clock
    times = clock.imu_time(reference.seconds)
    kept, means, which = [], [], []
    for m in range(rests.count):
        a, b = np.searchsorted(times, [t[rests.first[m]], t[rests.last[m] - 1]])
        if b <= a:
            continue
        mean, change = _mean(reference, slice(int(a), int(b)))
        if change > _MOVED:
            continue
        kept.append(m)
        means.append(mean)
        which.append((a + b) // 2)
    return rests.part(np.array(kept, dtype=np.int64)), np.array(means).reshape(-1, 4), np.array(which, dtype=np.int64)


def _mean(reference: ReferencePoses, own: slice) -> tuple[Array, float]:
    """Return the mean attitude of some poses (4,), and by how much they change from the first half to the second."""
    assert reference.quaternions is not None  # noqa: S101 - the caller has checked it
    q = reference.quaternions[own]
    away = log(multiply(conjugate(q[0]), q))
    half = len(q) // 2
    change = 0.0 if half == 0 else float(np.linalg.norm(away[-half:].mean(axis=0) - away[:half].mean(axis=0)))
    return multiply(q[0], exp(away.mean(axis=0))), change


def _robot(robot: RobotModel, which: Indices) -> tuple[Array, Array]:
    """Return the effect of the robot's errors on attitudes at poses, (M, 3, e), in deviations of each (e,)."""
    errors = RobotParameters.none(robot.joints)
    at = np.concatenate([np.arange(errors.vector.size)[errors.part(g)] for g in ROBOT_GROUPS if g in robot.covariance])
    variance = np.concatenate([np.diag(robot.covariance[g]) for g in ROBOT_GROUPS if g in robot.covariance])
    effect = robot.regressor(which, errors.zeros)[:, 3:, at] * np.sqrt(variance)
    seen = np.abs(effect).max(axis=(0, 1)) > _NOTHING
    return effect[:, :, seen], np.ones(np.count_nonzero(seen))


def _linear(q: Array, angle: float) -> tuple[Array, Array]:
    """Return the effect of errors that are linear in the attitude q (M, 4), as of `_robot`; none without an arm's."""
    effect = rotations_by_attitude(q, angle) if angle else np.zeros((len(q), 3, 0))
    return effect, np.ones(effect.shape[2])

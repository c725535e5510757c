"""The robot calibrated by the IMU: its errors, and how much better they predict poses that were not used.

After Alban and Janocha: the errors of an arm's model are part of the calibration of the IMU that it moves. Whether they
are errors of the arm shows where they were not found: another recording, or the other half of one, finds the pose
errors of its own by its own IMU readings; what the errors from elsewhere leave of them is what remains on unused poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.calibration.arm_result import BEYOND_URDF, ArmCalibration, ArmError, UnusedPoses
from kreisel.calibration.assembly import arm_covariances
from kreisel.calibration.joint_outcome import Joint
from kreisel.calibration.outcome import Outcome
from kreisel.calibration.result import Calibration
from kreisel.calibration.result_sections import RobotErrors, Verdict
from kreisel.calibration.split_halves import fits_of_halves
from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, Indices, Mask
from kreisel.model.parameters import ROBOT_GROUPS, RobotParameters, parameter_names
from kreisel.model.problem import Problem
from kreisel.model.robot_model import RobotModel, within_frames
from kreisel.progress import Progress
from kreisel.recording.recording import DataWarning, Recording
from kreisel.refinement.estimate import Estimate
from kreisel.robot.pose_accuracy import PoseAccuracy
from kreisel.tasks import Executor, sequential
from kreisel.units import MM, MRAD

_NO_ARM = (
    "errors of a robot need its joint angles and its description: joint0/data.csv and robot.urdf beside pose0, or "
    "robot.model in recording.toml"
)

_LEAST = 1e-6
"""Least variance of a difference, in that of the prior: what both know by the prior alone differs by nothing, and
rounding must not make that negative."""

_MORE = 1.2
"""Pose errors left by robot.urdf alone, over those left by all that was found, from which on that is said."""

_NEGATIVE = 4.0
"""Deviations by which a compliance is negative, that no arm has."""


@dataclass(frozen=True)
class _Known:
    """What a part of the data says of the arm's errors: mean and covariance (e,), and covariance before, all of it."""

    name: str
    model: RobotModel
    mean: Array
    covariance: Array
    prior: Array


def arm_of(outcome: Outcome, progress: Progress | None = None, executor: Executor = sequential) -> ArmCalibration:
    """Return the robot's errors by one recording.

    Raises
    ------
    RecordingError
        If the arm or its joint angles are not known.
    """
    found = outcome.estimate
    parts = [] if found.problem.robot is None else _halves(found, progress, executor)
    return _judged(outcome.calibration, parts, outcome.warnings, outcome.recording)


def arm_of_all(joint: Joint) -> ArmCalibration:
    """Return the robot's errors by several recordings that were calibrated together.

    Raises
    ------
    RecordingError
        If the arm or its joint angles are not known.
    """
    found = zip(joint.names, joint.outcomes, strict=True)
    parts = [_known(name, one.estimate.problem, *_of(one.estimate)) for name, one in found if one.problem.robot]
    return _judged(joint.calibration, parts, joint.warnings, joint.outcomes[0].recording)


def _judged(
    calibration: Calibration, parts: Sequence[_Known], warnings: tuple[DataWarning, ...], recording: Recording
) -> ArmCalibration:
    if calibration.robot is None:
        known = [one.message for one in warnings if one.subject == "robot" and recording.joints is not None]
        reason = f"its arm cannot be calibrated: {known[0]}" if known else _NO_ARM
        raise RecordingError(reason, file=recording.path)
    errors, unused = _errors(calibration), _unused(parts)
    if any(_leaves_more(one) for one in unused):
        warnings = (*warnings, DataWarning("robot", BEYOND_URDF))
    verdict = _without_negative(calibration.verdict, errors)
    return ArmCalibration(replace(calibration, verdict=verdict), calibration.robot, errors, unused, warnings)


def _leaves_more(part: UnusedPoses) -> bool:
    """Return whether robot.urdf alone leaves more of the pose errors than all errors that were found."""
    return part.by_urdf is not None and (
        part.by_urdf.position > _MORE * part.after.position or part.by_urdf.orientation > _MORE * part.after.orientation
    )


def _without_negative(verdict: Verdict, errors: Sequence[ArmError]) -> Verdict:
    """Return the verdict, with a reason against joints that yield against their load."""
    bad = [
        one for one in errors
        if one.name.startswith("robot.compliance") and one.value < -_NEGATIVE * one.deviation
    ]  # fmt: skip
    if not bad:
        return verdict
    names = ", ".join(one.title.split(":")[0] for one in bad)
    reason = (
        f"the compliance of {names} is negative, which no joint has: another error of the arm is taken for it, perhaps "
        "a gear ratio or an encoder's scale; check those, and the masses in robot.urdf"
    )
    return replace(verdict, accepted=False, reasons=(*verdict.reasons, reason))


def _of(found: Estimate) -> tuple[RobotParameters, Array]:
    return found.run.parameters.robot, found.belief.covariance


def _halves(found: Estimate, progress: Progress | None, executor: Executor) -> list[_Known]:
    """Return what each half of a recording says by itself; nothing if they are too short."""
    fits = fits_of_halves(found, progress, executor)
    if fits is None:
        return []
    return [
        _known(name, found.problem, fit.parameters.robot, fit.belief.covariance)
        for name, fit in zip(("first half", "second half"), fits, strict=True)
    ]


def _known(name: str, problem: Problem, errors: RobotParameters, covariance: Array) -> _Known:
    """Return what a belief says of an arm's errors."""
    robot = problem.robot
    assert robot is not None  # noqa: S101 - the caller has checked it
    return _Known(name, robot, errors.vector, *arm_covariances(problem, errors, covariance))


def _errors(calibration: Calibration) -> tuple[ArmError, ...]:
    """Return each estimated error."""
    robot = calibration.robot
    assert robot is not None  # noqa: S101 - the caller has checked it
    at = {name: i for i, name in enumerate(calibration.names)}
    joints, out = len(robot.joints), []
    for group in ROBOT_GROUPS:
        own = getattr(robot, group.removeprefix("robot_"))
        if own is None:
            continue
        names = parameter_names(group, 1, joints)
        for k, (name, value) in enumerate(zip(names, own.value.ravel().tolist(), strict=True)):
            if name in at:
                i = at[name]
                sd = float(np.sqrt(calibration.covariance[i, i]))
                said = _in_words(robot, group, k)
                out.append(ArmError(name, *said, value, sd, float(calibration.prior_deviation[i])))
    return tuple(out)


def _in_words(robot: RobotErrors, group: str, k: int) -> tuple[str, str, float]:
    """Return title, unit and size of the unit of the error number k of a group."""
    if group == "robot_placement":
        places = (*robot.joints, "tool")
        kind = ("length along", "mm", MM) if k % 6 < 3 else ("angle about", "mrad", MRAD)
        return f"{places[k // 6]}: {kind[0]} {'xyz'[k % 3]}", kind[1], kind[2]
    if group == "robot_gears":
        return f"{robot.joints[k // 2]}: gear, {('sine', 'cosine')[k % 2]} of the angle", "mrad", MRAD
    if group == "robot_compliance":
        return f"{robot.joints[k]}: compliance", "µrad/(N m)", 1e-6
    return f"{robot.joints[k + 1]}: zero", "mrad", MRAD


def _unused(parts: Sequence[_Known]) -> tuple[UnusedPoses, ...]:
    """Return, for each part, what the errors found from the others leave of its pose errors."""
    if len(parts) < 2:
        return ()
    out = []
    for part in parts:
        others = [one for one in parts if one is not part]
        both = np.diag(part.prior) > 0.0
        for one in others:
            both &= np.diag(one.prior) > 0.0
        at = np.flatnonzero(both)
        mean, covariance = _together(others, at)
        J = within_frames(part.model, 300)[:, :, at]
        own, P = part.covariance[np.ix_(at, at)], part.prior[np.ix_(at, at)]
        shared = own @ np.linalg.solve(P, covariance)  # equation (22)
        apart = own + covariance - shared - shared.T
        size = np.sqrt(np.diag(P))
        values, axes = np.linalg.eigh(apart / np.outer(size, size))  # lengths, angles and compliances are not alike
        axes = axes * size[:, None]
        apart = (axes * np.maximum(values, _LEAST)) @ axes.T
        found, written = part.mean[at], _in_urdf(part.model, at)
        out.append(
            UnusedPoses(
                part.name,
                ", ".join(one.name for one in others),
                PoseAccuracy.of((J @ found) ** 2),
                PoseAccuracy.of((J @ (found - mean)) ** 2),
                PoseAccuracy.of(np.sum((J @ apart) * J, axis=2)),
                None if written.all() else PoseAccuracy.of((J @ (found - written * mean)) ** 2),
            )
        )
    return tuple(out)


def _in_urdf(model: RobotModel, at: Indices) -> Mask:
    """Return which errors, of places `at` in the vector of all, a robot description holds."""
    errors = RobotParameters.none(model.joints)
    held = np.zeros(errors.vector.size, dtype=bool)
    for group in ("robot_placement", "robot_zeros"):
        held[errors.part(group)] = True
    return held[at]


def _together(parts: Sequence[_Known], at: Indices) -> tuple[Array, Array]:
    """Return mean and covariance (e,) by several parts that share their prior, of zero mean."""
    prior = np.linalg.inv(parts[0].prior[np.ix_(at, at)])
    information, weighted = prior.copy(), np.zeros(at.size)
    for one in parts:
        own = np.linalg.inv(one.covariance[np.ix_(at, at)])
        information += own - prior
        weighted += own @ one.mean[at]
    covariance = np.linalg.inv(information)
    return covariance @ weighted, covariance

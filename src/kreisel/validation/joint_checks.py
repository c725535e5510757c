"""Checks of joint angles: degrees that are read as radians, and stamps that differ from those of the poses."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError, RobotError
from kreisel.geometry.interpolation import nearest
from kreisel.geometry.rotation import Array, Indices, Mask, conjugate, lengths, log, multiply
from kreisel.recording.location import header_fault, is_table
from kreisel.recording.recording import DataWarning, JointAngles, ReferencePoses, Stamps
from kreisel.robot import kinematics
from kreisel.robot.description import Arm, parse_arm
from kreisel.units import DEG
from kreisel.validation.finite_values import check_finite
from kreisel.validation.stamp_checks import check_stamps

SAME_FRAME = (5e-3, 5e-3)
"""m and rad; reported poses this near to the nominal kinematics have the same base and tool frame."""

_SAME_STAMP = 0.01
"""Share of the joint angles' interval by which a pose's stamp may differ, because one of them may be rounded."""

_WHOLE_TURNS = 4.0 * np.pi
"""rad; angles that only axes of unlimited range reach."""

_MARGIN = 0.5
"""rad; an angle cannot be farther than this beyond a joint's limits."""


def check_joints(joints: JointAngles) -> None:
    """Raise an error unless stamps ascend and angles are numbers.

    Raises
    ------
    RecordingError
        With the first place where they do not.
    """
    check_stamps(joints, "joint angle")
    names = tuple(f"q_{k + 1}" for k in range(joints.angles.shape[1]))
    check_finite(joints.angles, names, joints)


def joint_stamp_warnings(joints: JointAngles, reference: ReferencePoses) -> list[DataWarning]:
    """Return the warning about poses at whose stamps there are no joint angles: they are interpolated there."""
    _, same = _nearest(joints.stamps_ns, reference.stamps_ns)
    missing = int(np.sum(~same))
    if not missing:
        return []
    text = f"{missing} of {reference.stamps_ns.size} poses have no joint angles of the same stamp; interpolated there"
    return [DataWarning("joints", f"{joints.source.parent.name}: {text}")]


def angles_at(joints: JointAngles, stamps: Stamps) -> Array:
    """Return the joint angles at stamps (m,), (m, joints): those of the same moment, otherwise interpolated ones."""
    places, same = _nearest(joints.stamps_ns, stamps)
    between = np.column_stack([np.interp(stamps, joints.stamps_ns, column) for column in joints.angles.T])
    return np.where(same[:, None], joints.angles[places], between)


def _nearest(own: Stamps, stamps: Stamps) -> tuple[Indices, Mask]:
    """Return the index of the nearest of the own stamps, and whether it is of the same moment."""
    places = nearest(own, stamps)
    return places, np.asarray(np.abs(own[places] - stamps) <= _SAME_STAMP * float(np.median(np.diff(own))))


def joints_in_radians(
    joints: JointAngles, urdf: str | None, tcp: str | None, reference: ReferencePoses | None
) -> tuple[JointAngles, list[DataWarning]]:
    """Return the joint angles, converted where no unit is stated and the poses prove that they are degrees.

    They are compared with the poses only if some are beyond a full turn, or a joint's limits; smaller ones are checked
    where the robot's errors are estimated.

    Raises
    ------
    RecordingError
        If they look like degrees and the poses do not prove it, or the header says otherwise.
    """
    arm = None
    if urdf is not None and float(np.abs(joints.angles).max()) > np.pi:
        with suppress(RobotError):  # the error is raised where the description is needed
            arm = parse_arm(urdf, tcp)
        if arm is not None and len(arm.joints) != joints.angles.shape[1]:
            arm = None
    if not _look_like_degrees(joints, arm):
        return joints, []
    if arm is not None and reference is not None:
        angles = angles_at(joints, reference.stamps_ns)
        if near(distance(arm, angles, reference)):
            return joints, []
        if near(distance(arm, DEG * angles, reference)):
            return in_degrees(joints)
    raise looks_like_degrees(joints, f"joint angles reach {np.abs(joints.angles).max():.4g}")


def _look_like_degrees(joints: JointAngles, arm: Arm | None) -> bool:
    """Return whether joint angles look like degrees.

    They do where several joints go beyond two turns, or where one does, exceeds its limits, and all are within their
    limits as degrees. Several may go beyond where the unit is stated, or is fixed as in a ROS message, because wheels
    and turntables have no limits.
    """
    low, high = joints.angles.min(axis=0), joints.angles.max(axis=0)
    far = np.maximum(-low, high) > _WHOLE_TURNS
    if is_table(joints.source) and joints.units.angle is None and int(far.sum()) > 1:
        return True
    if arm is None:
        return False
    beyond = far & ((low < arm.lower - _MARGIN) | (high > arm.upper + _MARGIN))
    within = (DEG * low > arm.lower - _MARGIN) & (DEG * high < arm.upper + _MARGIN)
    return bool(beyond.any() and within.all())


def in_degrees(joints: JointAngles) -> tuple[JointAngles, list[DataWarning]]:
    """Return joint angles in degrees converted to radians, and the warning about it.

    Raises
    ------
    RecordingError
        If the header says that they are in another unit.
    """
    if joints.units.angle is not None:
        raise looks_like_degrees(joints, "the poses fit the joint angles as degrees")
    where = "write q_1 [deg] into the header" if is_table(joints.source) else "ROS messages are in rad: convert them"
    text = f"joint angles are in degrees, as the poses show, and were converted; {where}"
    return replace(joints, angles=DEG * joints.angles), [DataWarning("joints", f"{joints.source.parent.name}: {text}")]


def looks_like_degrees(joints: JointAngles, evidence: str) -> RecordingError:
    """Return the error for joint angles that look like degrees and are read in another unit."""
    if not is_table(joints.source):
        remedy = "ROS messages are in rad: convert them"
    elif joints.units.angle is None:
        remedy = "write q_1 [deg] into the header"
    else:
        remedy = f"the header says [{joints.units.angle}]: correct it, or the numbers"
    return header_fault(joints.source, f"{evidence}: joint angles look like degrees; {remedy}")


def distance(arm: Arm, angles: Array, reference: ReferencePoses) -> tuple[float, float]:
    """Return the median distance of reported poses from the nominal kinematics at angles (m, joints), m and rad."""
    some = slice(None, None, max(1, len(angles) // 500))
    p, q = kinematics.poses(arm, angles[some])
    apart, turned = 0.0, 0.0
    if reference.positions is not None:
        apart = float(np.median(lengths(p - reference.positions[some])))
    if reference.quaternions is not None:
        turned = float(np.median(lengths(log(multiply(conjugate(q), reference.quaternions[some])))))
    return apart, turned


def near(far: tuple[float, float]) -> bool:
    """Return whether reported poses have the same base and tool frame as the kinematics."""
    return all(d <= limit for d, limit in zip(far, SAME_FRAME, strict=True))

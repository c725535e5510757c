"""The robot of a recording as part of the problem, and the assumptions about its errors."""

from __future__ import annotations

import numpy as np

from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array
from kreisel.model.robot_model import RobotModel
from kreisel.preparation.arm_of_poses import arm_of_poses
from kreisel.recording.recording import DataWarning, JointAngles, ReferencePoses
from kreisel.recording.recording_settings import RobotTable
from kreisel.robot import kinematics
from kreisel.robot.description import Arm, parse_arm
from kreisel.units import DEG
from kreisel.validation.joint_checks import angles_at, distance, in_degrees, near

LENGTH_SD, ANGLE_SD = 5e-4, 5e-4
"""m and rad; standard deviations of a joint's placement from the model, where the user states none."""

_GEAR_SD = 2e-4
_SAG_SD = 5e-4
"""rad; eccentricity, and sag under the largest torque of the motion."""

_ZERO_SD, _SLIDE_SD = 0.02, 5e-3
"""rad and m; errors of zeros of arms whose calibration was lost: a counter set by the marks is off by degrees."""

_MAX_WITHOUT = 0.01
"""Share of poses that may lie before or after the joint angles."""


def robot_model(
    table: RobotTable, urdf: str | None, joints: JointAngles | None, reference: ReferencePoses, *, arm: bool
) -> tuple[RobotModel | None, list[DataWarning]]:
    """Return the robot of a recording, or None and the warning why it cannot be used.

    arm: whether an arm reports the poses: without joint angles, it may be known.

    Raises
    ------
    RobotError
        If joint angles or poses and description do not belong together.
    """
    if joints is None:
        found, angles, warnings = arm_of_poses(table, urdf, reference, arm=arm)
    else:
        found, angles, warnings = _recorded(table, urdf, joints, reference)
    if found is None:
        return None, warnings
    length = LENGTH_SD if table.length_sd is None else max(table.length_sd, 1e-9)
    angle = ANGLE_SD if table.angle_sd is None else max(table.angle_sd, 1e-9)
    n = len(found.joints)
    torque = np.abs(kinematics.gravity_torques(found, angles[:: max(1, len(angles) // 500)])).max(axis=0)
    covariance = {
        "robot_placement": np.diag(np.tile(np.repeat([length, angle], 3), n + 1) ** 2),
        "robot_gears": _GEAR_SD**2 * np.eye(2 * n),
        "robot_compliance": np.diag((_SAG_SD / np.maximum(torque, 1.0)) ** 2),
        "robot_zeros": np.diag(np.where(found.chain.turning, _ZERO_SD, _SLIDE_SD)[1:-1] ** 2),
    }
    return RobotModel(found, angles, covariance, stated=table.angle_sd is not None), warnings


def _recorded(
    table: RobotTable, urdf: str | None, joints: JointAngles, reference: ReferencePoses
) -> tuple[Arm | None, Array, list[DataWarning]]:
    """Return the arm of a recording with joint angles, the angles at every pose, and warnings; no arm if unusable."""
    nothing = np.zeros((0, 0))
    if urdf is None:
        message = "there are joint angles, but no robot.urdf: with it, the robot's own errors would be estimated too"
        return None, nothing, [DataWarning("robot", f"{message}; they are treated as noise")]
    arm = parse_arm(urdf, table.tcp, table.urdf or "robot.urdf")
    if joints.angles.shape[1] != len(arm.joints):
        raise RobotError(
            f"{joints.source}: {joints.angles.shape[1]} joint angles, but {len(arm.joints)} joints of {arm.name} move "
            f"'{arm.tcp}': {', '.join(arm.joints)}; correct robot.urdf, or robot.tcp in recording.toml"
        )
    stamps = reference.stamps_ns
    without = (stamps < joints.stamps_ns[0]) | (stamps > joints.stamps_ns[-1])
    if float(without.mean()) > _MAX_WITHOUT:
        message = (
            f"{int(without.sum())} of {without.size} poses lie before or after the recorded joint angles; the robot's "
            "errors are treated as noise: record both all the time"
        )
        return None, nothing, [DataWarning("robot", message)]
    warnings: list[DataWarning] = []
    angles = angles_at(joints, stamps)
    far = distance(arm, angles, reference)
    if not near(far) and near(distance(arm, DEG * angles, reference)):
        joints, warnings = in_degrees(joints)
        angles = angles_at(joints, stamps)
    elif not near(far):
        return (
            None,
            nothing,
            [
                DataWarning(
                    "robot",
                    f"reported poses differ by {far[0] * 1e3:.3g} mm and {far[1] * 1e3:.3g} mrad (median) from those "
                    f"of {arm.name} at the recorded joint angles: base or tool frame differ, or order or signs of the "
                    "joints; errors are treated as noise. Add the frames to robot.urdf and name the tool in "
                    "recording.toml: robot.tcp",
                )
            ],
        )
    return arm, angles, warnings

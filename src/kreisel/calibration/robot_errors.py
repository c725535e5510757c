"""The robot's own errors as part of the problem: what they do to the reported poses, and what is believed of them.

A controller computes the pose it reports by the kinematics it believes in, from the angles its motors
show. The tool stands elsewhere, by something that is nearly linear in a few dozen small errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.parameters import RobotParameters
from kreisel.errors import RobotError
from kreisel.geometry.rotation import Array, Indices
from kreisel.recording import Finding, Recording, ReferencePoses
from kreisel.recording.joint_checks import angles_at, distance, in_degrees, near
from kreisel.robot import kinematics
from kreisel.robot.kinematics import Arm, parse_arm
from kreisel.units import DEG

LENGTH_SD, ANGLE_SD = 5e-4, 5e-4
"""m and rad; how far a joint's placement is from the model, where the user does not say."""

_GEAR_SD = 2e-4
_SAG_SD = 5e-4
"""rad; eccentricity, and sag under the largest torque met."""

_MOST_WITHOUT = 0.01
"""Share of poses that may lie beyond the joint angles' ends."""


@dataclass(frozen=True)
class RobotModel:
    """An arm and what its errors do.

    Attributes
    ----------
    arm
        As its controller believes it to be.
    angles : (m, n)
        Joint angles at every pose of the reference.
    covariance
        Of each robot group, before any look at the data.
    """

    arm: Arm
    angles: Array
    covariance: dict[str, Array]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.arm.joints)

    def regressor(self, which: Indices) -> Array:
        """Return what the robot's errors (9 n + 6) do to chosen poses, (k, 6, 9 n + 6): actual less reported.

        Rows: position in r, rotation as a right perturbation. Columns: `RobotParameters.vector`.
        """
        return pose_regressor(self.arm, self.angles[which])


def pose_regressor(arm: Arm, angles: Array) -> Array:
    """Return what the errors of an arm (9 n + 6) do to its tool's pose at joint angles (k, n), (k, 6, 9 n + 6)."""
    placement = kinematics.regressor(arm, angles)
    J = kinematics.joint_jacobian(arm, angles)
    gears = np.stack([J * np.sin(angles)[:, None], J * np.cos(angles)[:, None]], axis=-1).reshape(len(angles), 6, -1)
    sag = -J * kinematics.gravity_torques(arm, angles)[:, None]
    return np.concatenate([placement, gears, sag], axis=2)


def robot_model(recording: Recording, reference: ReferencePoses) -> tuple[RobotModel | None, list[Finding]]:
    """Return the robot of a recording, or None and why it cannot be used.

    Raises
    ------
    RobotError
        If joint angles and description do not belong together.
    """
    joints, table = recording.joints, recording.settings.robot
    if joints is None:
        return None, []
    if recording.urdf is None:
        said = "joint angles are there, but no robot.urdf: with it, the robot's own errors would be estimated too"
        return None, [Finding("robot", f"{said}; they are taken for noise")]
    try:
        kinematics.pinocchio()
    except RobotError as error:
        return None, [Finding("robot", f"{error}; without it, the robot's geometric errors are taken for noise")]
    arm = parse_arm(recording.urdf, table.tcp, table.urdf or "robot.urdf")
    if joints.angles.shape[1] != len(arm.joints):
        raise RobotError(
            f"{joints.source}: {joints.angles.shape[1]} joint angles, but {len(arm.joints)} joints of {arm.name} move "
            f"'{arm.tcp}': {', '.join(arm.joints)}; correct robot.urdf, or robot.tcp in recording.toml"
        )
    stamps = reference.stamps_ns
    without = (stamps < joints.stamps_ns[0]) | (stamps > joints.stamps_ns[-1])
    if float(without.mean()) > _MOST_WITHOUT:
        said = f"{int(without.sum())} of {without.size} poses lie before or after the recorded joint angles"
        return None, [Finding("robot", f"{said}; the robot's errors are taken for noise: record both all the time")]
    findings: list[Finding] = []
    angles = angles_at(joints, stamps)
    far = distance(arm, angles, reference)
    if not near(far) and near(distance(arm, DEG * angles, reference)):
        joints, findings = in_degrees(joints)
        angles = angles_at(joints, stamps)
    elif not near(far):
        return None, [
            Finding(
                "robot",
                f"reported poses stand {far[0] * 1e3:.3g} mm and {far[1] * 1e3:.3g} mrad (median) from those of "
                f"{arm.name} at the recorded joint angles, so base or tool frame differ; errors are taken for noise. "
                "Add the frames to robot.urdf and name the tool in recording.toml: robot.tcp",
            )
        ]
    length = LENGTH_SD if table.length_sd is None else max(table.length_sd, 1e-9)
    angle = ANGLE_SD if table.angle_sd is None else max(table.angle_sd, 1e-9)
    n = len(arm.joints)
    torque = np.abs(kinematics.gravity_torques(arm, angles[:: max(1, len(angles) // 500)])).max(axis=0)
    covariance = {
        "robot_placement": np.diag(np.tile(np.repeat([length, angle], 3), n + 1) ** 2),
        "robot_gears": _GEAR_SD**2 * np.eye(2 * n),
        "robot_compliance": np.diag((_SAG_SD / np.maximum(torque, 1.0)) ** 2),
    }
    return RobotModel(arm, angles, covariance), findings


NOT_SEPARABLE = 0.9
"""A standard deviation still above this share of the prior's: the motion does not tell this error from others."""


@dataclass(frozen=True)
class PoseAccuracy:
    """How far the tool stands from its reported poses, rms over poses: m and rad.

    Apart from where base and tool frame lie: those the user sets, and no IMU sees.
    """

    position: float
    orientation: float


def expected_accuracy(model: RobotModel, covariance: Array, poses: int = 300) -> PoseAccuracy:
    """Return the accuracy a covariance of the robot's errors (9 n + 6) stands for, over the motion's poses."""
    J = _within_frames(model, poses)
    return _accuracy(np.einsum("kij,jl,kil->ki", J, covariance, J))


def shift(model: RobotModel, errors: RobotParameters, poses: int = 300) -> PoseAccuracy:
    """Return how far errors of the robot move its tool."""
    return _accuracy((_within_frames(model, poses) @ errors.vector) ** 2)


def _within_frames(model: RobotModel, poses: int) -> Array:
    """Return regressors of evenly chosen poses without what another base or tool frame would do as well."""
    which = np.linspace(0, len(model.angles) - 1, min(poses, len(model.angles))).astype(np.int64)
    J = model.regressor(which)
    last = 6 * model.joints
    frames = np.concatenate([J[:, :, :6], J[:, :, last : last + 6]], axis=2).reshape(-1, 12)
    flat = J.reshape(len(frames), -1)
    return np.asarray((flat - frames @ np.linalg.lstsq(frames, flat, rcond=None)[0]).reshape(J.shape))


def _accuracy(square: Array) -> PoseAccuracy:
    """Return the accuracy from squared pose errors (k, 6)."""
    position, orientation = (float(np.sqrt(np.mean(np.sum(part, axis=1)))) for part in (square[:, :3], square[:, 3:]))
    return PoseAccuracy(position, orientation)

"""A robot whose own errors are part of the problem: their effect on the reported poses.

A controller computes the pose it reports by its nominal kinematics, from the angles of its motors. The difference of
the true pose from it is nearly linear in a few dozen small errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, Indices, conjugate, multiply
from kreisel.model.parameters import RobotParameters
from kreisel.robot import kinematics
from kreisel.robot.description import Arm
from kreisel.robot.pose_accuracy import PoseAccuracy


@dataclass(frozen=True)
class RobotModel:
    """An arm and the effect of its errors.

    Attributes
    ----------
    arm
        The controller's model.
    angles : (m, n)
        Joint angles at every pose of the reference.
    covariance
        Of each robot group, before any look at the data.
    stated
        Whether the user states how large the errors of the placements' angles are.
    """

    arm: Arm
    angles: Array
    covariance: dict[str, Array]
    stated: bool = False

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.arm.joints)

    def regressor(self, which: Indices, zeros: Array) -> Array:
        """Return the effect of the robot's errors (e,) on chosen poses, (k, 6, e): actual less reported.

        Rows: position in r, rotation as a right perturbation. Columns: `RobotParameters.vector`.

        zeros: of the joints between the first and the last (n - 2,), about which it is linear.
        """
        return pose_regressor(self.arm, self.moved_angles(which, zeros))

    def moved_angles(self, which: Indices, zeros: Array) -> Array:
        """Return the joint angles (k, n) at chosen poses with errors of the zeros (n - 2,) added."""
        angles = self.angles[which].copy()
        angles[:, 1:-1] += zeros
        return angles

    def moved_poses(self, which: Indices, zeros: Array) -> tuple[Array, Array]:
        """Return the motion of poses by errors of zeros: shifts (k, 3) in r, rotations (k, 4) in the tool's frame."""
        p, q = kinematics.poses(self.arm, self.angles[which])
        p_moved, q_moved = kinematics.poses(self.arm, self.moved_angles(which, zeros))
        return p_moved - p, multiply(conjugate(q), q_moved)


def pose_regressor(arm: Arm, angles: Array) -> Array:
    """Return the effect of an arm's errors (10 n + 4) on its tool's pose at joint angles (k, n), (k, 6, 10 n + 4)."""
    placement, J, torques = kinematics.derivatives(arm, angles)  # equation (16)
    gears = np.stack([J * np.sin(angles)[:, None], J * np.cos(angles)[:, None]], axis=-1).reshape(len(angles), 6, -1)
    return np.concatenate([placement, gears, -J * torques[:, None], J[:, :, 1:-1]], axis=2)


def expected_accuracy(model: RobotModel, covariance: Array, poses: int = 300) -> PoseAccuracy:
    """Return the accuracy by a covariance of the robot's errors (10 n + 4), over the motion's poses."""
    J = within_frames(model, poses)
    return PoseAccuracy.of(np.sum((J @ covariance) * J, axis=2))


def shift(model: RobotModel, errors: RobotParameters, poses: int = 300) -> PoseAccuracy:
    """Return how far errors of the robot move its tool."""
    return PoseAccuracy.of((within_frames(model, poses) @ errors.vector) ** 2)


def within_frames(model: RobotModel, poses: int) -> Array:
    """Return regressors (k, 6, e) of evenly chosen poses, without what another base or tool frame would cause too."""
    which = np.linspace(0, len(model.angles) - 1, min(poses, len(model.angles))).astype(np.int64)
    J = model.regressor(which, RobotParameters.none(model.joints).zeros)
    last = 6 * model.joints
    frames = np.concatenate([J[:, :, :6], J[:, :, last : last + 6]], axis=2).reshape(-1, 12)
    flat = J.reshape(len(frames), -1)
    return np.asarray((flat - frames @ np.linalg.lstsq(frames, flat, rcond=None)[0]).reshape(J.shape))


NOT_SEPARABLE = 0.9
"""If a standard deviation is still above this share of the prior's, the error cannot be distinguished from others."""

"""Kinematics of chains of any joints against pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from kreisel._kernels import chain
from kreisel._kernels.joint_chain import Chain

JOINTS = (
    pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ,
    lambda: pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
    lambda: pin.JointModelPrismaticUnaligned(np.array([0.0, -0.6, 0.8])),
)  # fmt: skip
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8]])
TURNING = np.array([True, True, True, False, False, False, True, False])


@pytest.fixture(params=range(4))
def arms(request):
    """A random chain as pinocchio has it, with the number of its tool's frame, and as the library has it."""
    rng = np.random.default_rng(request.param)
    model, parent, placements, bodies = pin.Model(), 0, [], []
    kinds = rng.permutation(len(JOINTS))
    for kind in kinds:
        placement = pin.SE3.Random()
        parent = model.addJoint(parent, JOINTS[kind](), placement, f"j{len(placements)}")
        body = pin.Inertia(rng.uniform(0.5, 5.0), rng.normal(size=3), np.eye(3))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        placements.append(placement)
        bodies.append([body.mass, *body.lever])
    placements.append(pin.SE3.Random())
    frame = model.addFrame(pin.Frame("tool", parent, 0, placements[-1], pin.FrameType.BODY))
    own = Chain(
        np.array([p.rotation.ravel() for p in placements]), np.array([p.translation for p in placements]),
        AXES[kinds].astype(float), TURNING[kinds], np.array(bodies),
    )  # fmt: skip
    return model, frame, own, rng.normal(size=(3, 5, len(kinds)))


def test_motion_is_pinocchios(arms):
    model, frame, own, moving = arms
    attitude, p, v, a, omega, alpha = chain.motion(own, *moving)
    C = Rotation.from_quat(attitude, scalar_first=True).as_matrix()
    assert np.all(np.sum(attitude[1:] * attitude[:-1], axis=1) >= 0.0)
    data = model.createData()
    for k, (q, dq, ddq) in enumerate(zip(*moving, strict=True)):
        pin.forwardKinematics(model, data, q, dq, ddq)
        there = pin.updateFramePlacement(model, data, frame)
        np.testing.assert_allclose(C[k], there.rotation, atol=1e-12)
        np.testing.assert_allclose(p[k], there.translation, atol=1e-12)
        twist = pin.getFrameVelocity(model, data, frame, pin.LOCAL)
        acceleration = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL)
        np.testing.assert_allclose(C[k].T @ v[k], twist.linear, atol=1e-11)
        np.testing.assert_allclose(omega[k], twist.angular, atol=1e-11)
        np.testing.assert_allclose(C[k].T @ a[k], acceleration.linear, atol=1e-10)
        np.testing.assert_allclose(alpha[k], acceleration.angular, atol=1e-10)


def test_derivatives_and_torques_are_pinocchios(arms):
    model, frame, own, (angles, *_) = arms
    regressor, jacobian, torques = chain.derivatives(own, angles, 9.81)
    data, n = model.createData(), model.nv
    for k, q in enumerate(angles):
        pin.computeJointJacobians(model, data, q)
        C = pin.updateFramePlacement(model, data, frame).rotation
        local = pin.computeFrameKinematicRegressor(model, data, frame, pin.LOCAL)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        np.testing.assert_allclose(C.T @ regressor[k, :3, : 6 * n], local[:3], atol=1e-11)
        np.testing.assert_allclose(regressor[k, 3:, : 6 * n], local[3:], atol=1e-11)
        np.testing.assert_allclose(C.T @ jacobian[k, :3], J[:3], atol=1e-11)
        np.testing.assert_allclose(jacobian[k, 3:], J[3:], atol=1e-11)
        np.testing.assert_allclose(
            regressor[k, :, 6 * n :], np.block([[C, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]]), atol=1e-12
        )
        np.testing.assert_allclose(torques[k], pin.computeGeneralizedGravity(model, data, q), atol=1e-10)

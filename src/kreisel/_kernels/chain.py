"""Kinematics of a serial arm: pose, motion and derivatives of its tool for joint angles."""

from __future__ import annotations

import ctypes

import numpy as np

from kreisel._kernels.compiled import check_count, function
from kreisel._kernels.joint_chain import MAX_JOINTS, Chain
from kreisel._kernels.views import Array, Pointer, StackView, TableView, check_lengths

check_count("joints", MAX_JOINTS)

_motion = function("chain_motion", Pointer(Chain), *[TableView] * 9)
_derivatives = function(
    "chain_derivatives", Pointer(Chain), TableView, ctypes.c_double, StackView, StackView, TableView
)


def motion(chain: Chain, angles: Array, rates: Array, accelerations: Array) -> tuple[Array, ...]:
    """Return the tool's motion for joint angles, rates and accelerations, (n, joints) each.

    Its attitudes (n, 4), without jumps of sign; position, velocity and acceleration in the base's axes, then rate and
    angular acceleration in the tool's, (n, 3) each.
    """
    n, joints = angles.shape
    _check(chain, joints)
    check_lengths(rates=(rates, (n, joints)), accelerations=(accelerations, (n, joints)))
    q, parts = np.empty((n, 4)), [np.empty((n, 3)) for _ in range(5)]
    given = (np.ascontiguousarray(part, dtype=float) for part in (angles, rates, accelerations))
    _motion(chain, *given, q, *parts)
    return q, *parts


def derivatives(chain: Chain, angles: Array, gravity: float) -> tuple[Array, Array, Array]:
    """Return how the tool's pose changes at joint angles (n, joints), and what holds the arm against gravity.

    The pose differentiated by errors of the placements, (n, 6, 6 (joints + 1)), and by the joint angles,
    (n, 6, joints): position in the base's axes, rotation in the tool's; torques or forces (n, joints).
    """
    n, joints = angles.shape
    _check(chain, joints)
    regressor, jacobian = np.empty((n, 6, 6 * joints + 6)), np.empty((n, 6, joints))
    torques = np.empty((n, joints))
    _derivatives(chain, np.ascontiguousarray(angles, dtype=float), gravity, regressor, jacobian, torques)
    return regressor, jacobian, torques


def _check(chain: Chain, joints: int) -> None:
    if not 0 < joints <= MAX_JOINTS:
        raise ValueError(f"{joints} joints; expected 1 to {MAX_JOINTS}")
    check_lengths(
        rotations=(chain.rotations, (joints + 1, 9)), translations=(chain.translations, (joints + 1, 3)),
        axes=(chain.axes, (joints, 3)), turning=(chain.turning, (joints,)), bodies=(chain.bodies, (joints, 4)),
    )  # fmt: skip

"""An elastic mount: the IMU tilts and shifts against the tool in proportion to the specific force."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kreisel.geometry.rotation import Array, apply, conjugate, exp, matrix
from kreisel.simulation.cell_settings import Imu

_STEP = 2e-3
"""s between values of which derivatives are taken. Chosen: short beside the time in which a controller accelerates."""

_ENOUGH = 3000
"""Times over which what is rigid is taken out."""

Motion = Callable[[Array], tuple[Array, Array, Array]]
"""From times (n,) to inertial rate, its derivative, and specific force of the tool, in b, (n, 3) each."""


@dataclass(frozen=True)
class ElasticMount:
    """What a mount gives way by.

    Attributes
    ----------
    bending : (3, 3)
        Rotation for a specific force, rad per m/s^2, both along the axes of the tool. Its trace is zero: a compliance
        is symmetric, and the torque of a force at an arm is across both.
    deflection : (3, 3)
        The same for the shift, m per m/s^2.
    """

    bending: Array
    deflection: Array

    @classmethod
    def rigid(cls) -> ElasticMount:
        """Return one that does not."""
        return cls(np.zeros((3, 3)), np.zeros((3, 3)))

    @classmethod
    def draw(cls, rng: np.random.Generator, imu: Imu) -> ElasticMount:
        """Return the mount of one device."""
        turn, shift = rng.normal(size=(2, 3, 3))
        return cls(imu.mount_bending_sd * (turn - np.trace(turn) / 3.0 * np.eye(3)), imu.mount_deflection_sd * shift)

    def moved(self, of_tool: Motion, attitude: Callable[[Array], Array], seconds: float) -> Motion:
        """Return the motion of the IMU's frame, where that of the tool and its attitude (n, 4) are given.

        Another rigid mount or origin is no part of it: the frame is the one that fits the tool best.
        """
        if not (self.bending.any() or self.deflection.any()):
            return of_tool
        some = np.linspace(0.0, seconds, _ENOUGH)
        force, C = of_tool(some)[2], matrix(attitude(some))
        turned = force.mean(axis=0) @ self.bending.T
        rigid = np.concatenate([np.broadcast_to(np.eye(3), C.shape), C], axis=2).reshape(-1, 6)
        shifts = np.linalg.lstsq(rigid, np.einsum("nij,nj->ni", C, force @ self.deflection.T).ravel(), rcond=None)[0]

        def own(t: Array) -> tuple[Array, Array]:
            force, back = of_tool(t)[2], conjugate(attitude(t))
            return force @ self.bending.T - turned, force @ self.deflection.T - apply(back, shifts[:3]) - shifts[3:]

        def motion(t: Array) -> tuple[Array, Array, Array]:
            omega, alpha, force = of_tool(t)
            before, now, after = own(t - _STEP), own(t), own(t + _STEP)
            turn, shift = now
            turned, shifted = ((b - a) / (2.0 * _STEP) for a, b in zip(before, after, strict=True))
            turning, shifting = (
                (b - 2.0 * at + a) / _STEP**2 for a, at, b in zip(before, now, after, strict=True)
            )  # fmt: skip
            back = conjugate(exp(turn))
            relative = shifting + 2.0 * np.cross(omega, shifted)
            relative += np.cross(alpha, shift) + np.cross(omega, np.cross(omega, shift))
            rate = apply(back, omega)
            return rate + turned, apply(back, alpha) + turning - np.cross(turned, rate), apply(back, force + relative)

        return motion

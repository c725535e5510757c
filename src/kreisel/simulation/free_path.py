"""Motion that no arm makes: a drone that starts, flies and lands, or a body that a hand turns without a rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kreisel.geometry.interpolation import continuous
from kreisel.geometry.rotation import Array, from_matrix
from kreisel.robot.kinematics import ToolMotion
from kreisel.robot.motion import Timeline
from kreisel.simulation.device_errors import smooth_step

_SINES = 5
"""Sines of each coordinate. Chosen: enough that a motion does not repeat itself; each is computed for every sample."""

_ON_GROUND, _RAMP = 3.0, 4.0
"""s after landing, and in which a flight begins and ends."""

_ANGLES = {"flight": (1.0, 0.3, 0.3), "hand": (2.0, 1.0, 2.0)}
"""rad; usual yaw, pitch and roll."""

_LENGTHS = {"flight": (1.2, 1.2, 0.5), "hand": (0.25, 0.25, 0.2)}
"""m; usual distance from the middle along each axis of r."""

_FASTEST = {"flight": 0.45, "hand": 0.6}
"""Hz."""


@dataclass(frozen=True)
class FreePath(Timeline):
    """Yaw, pitch, roll (rad) and position (m) as sums of sines, that fade out at rest.

    Attributes
    ----------
    amplitude, frequency, phase : (6, sines)
        Of each coordinate; the frequency in rad/s.
    """

    amplitude: Array
    frequency: Array
    phase: Array

    def at(self, t: Array) -> ToolMotion:
        """Return the body's motion at times (n,): closed forms, r points up along z."""
        x, dx, ddx = self._coordinates(t)
        yaw, pitch, roll = x[:3]
        sp, cp, sr, cr, sy, cy = (f(a) for a in (pitch, roll, yaw) for f in (np.sin, np.cos))
        C = np.array([
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ])  # fmt: skip
        q = continuous(from_matrix(np.moveaxis(C, 2, 0)))
        dyaw, dpitch, droll = dx[:3]
        ddyaw, ddpitch, ddroll = ddx[:3]
        # rates of b in terms of yaw, pitch and roll (intrinsic z, y, x)
        rates = np.array([droll - dyaw * sp, dpitch * cr + dyaw * cp * sr, -dpitch * sr + dyaw * cp * cr])
        slopes = np.array([
            ddroll - ddyaw * sp - dyaw * dpitch * cp,
            ddpitch * cr - dpitch * droll * sr + ddyaw * cp * sr + dyaw * (droll * cp * cr - dpitch * sp * sr),
            -ddpitch * sr - dpitch * droll * cr + ddyaw * cp * cr - dyaw * (dpitch * sp * cr + droll * cp * sr),
        ])  # fmt: skip
        return ToolMotion(x[3:].T, q, dx[3:].T, ddx[3:].T, rates.T, slopes.T)

    def _coordinates(self, t: Array) -> tuple[Array, Array, Array]:
        """Return all coordinates with their first and second derivatives, (6, n) each."""
        angle = self.frequency[:, :, None] * t + self.phase[:, :, None]
        a, w = self.amplitude[:, :, None], self.frequency[:, :, None]
        x, dx, ddx = ((a * part).sum(axis=1) for part in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
        share, slope, bend = _share(self.standstills, t)
        return share * x, slope * x + share * dx, bend * x + 2.0 * slope * dx + share * ddx


def _share(standstills: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return the share of the motion (n,): 0 at rest, 1 between, with its derivatives; 1 always without standstills."""
    if np.ptp(standstills[0]) == 0.0:
        return np.ones_like(t), np.zeros_like(t), np.zeros_like(t)
    rise, fall = smooth_step((t - standstills[0, 1]) / _RAMP), smooth_step((standstills[1, 0] - t) / _RAMP)
    return (
        rise[0] * fall[0],
        (rise[1] * fall[0] - rise[0] * fall[1]) / _RAMP,
        (rise[2] * fall[0] - 2.0 * rise[1] * fall[1] + rise[0] * fall[2]) / _RAMP**2,
    )


def free_path(
    rng: np.random.Generator, kind: Literal["flight", "hand"], seconds: float, first_rest: float, share: float
) -> FreePath:
    """Return a random path: a flight with standstills before and after, or a motion by hand without any.

    Parameters
    ----------
    share
        Size of the angles and lengths, in usual ones.
    """
    standstills = np.array([[0.0, first_rest], [seconds - _ON_GROUND, seconds]])
    if kind == "hand":
        standstills = np.array([[0.0, 0.0], [seconds, seconds]])
    size = share * np.array([*_ANGLES[kind], *_LENGTHS[kind]])
    amplitude = size[:, None] * rng.uniform(0.4, 1.0, (6, _SINES)) * (2.0 / _SINES) ** 0.5
    frequency = 2.0 * np.pi * rng.uniform(0.05, _FASTEST[kind], (6, _SINES))
    return FreePath(standstills, 0.0, amplitude, frequency, rng.uniform(0.0, 2.0 * np.pi, (6, _SINES)))

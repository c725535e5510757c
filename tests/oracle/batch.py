"""The most likely parameters of one trajectory from all its poses at once: no recursion, no sigma points.

Every pose is predicted from one start by integrating the corrected readings. Noise of the readings adds to all later
predictions; its covariance is written down whole. What is minimised is the squared distance of poses and prior in
that covariance: least squares, or total least squares, where the covariance changes with the matrices that the noise
passes.
"""

from typing import NamedTuple

import numpy as np

from . import quaternions as quat
from .plain_filter import Corrected, Imu, State, World, correct, gravity_and_earth_rate, minus, plus, propagate
from .quaternions import Array
from .strapdown import Trajectory

STEP = 1e-2
"""Of the differences, in deviations of the prior."""


class Poses(NamedTuple):
    """Reference times (m,), positions (m, 3), attitudes (m, 4), the samples (m,) next to them, and deviations."""

    tau: Array
    positions: Array
    quaternions: Array
    samples: Array
    position_sd: float
    orientation_sd: float


class Density(NamedTuple):
    """Noise densities of gyros and accelerometers."""

    gyro: float
    accel: float


class Found(NamedTuple):
    """The most likely state, its covariance, and the length of the last step in deviations."""

    mean: State
    covariance: Array
    moved: float


def estimate(
    imu: Imu,
    poses: Poses,
    start: State,
    P: Array,
    density: Density,
    world: World,
    *,
    total: bool,
    rounds: int = 25,
) -> Found:
    """Return the most likely state (error coordinates of `plain_filter`), its prior being `start` with P (46, 46).

    Parameters
    ----------
    total
        Whether the covariance changes with the matrices while the sum is minimised (Deming's regression), so that noise
        in the readings does not pull at them.
    """
    mean, sd = start, np.sqrt(np.diag(P))
    inverse = np.linalg.inv(P)
    moved = np.inf
    for _ in range(rounds):
        columns = np.diag(STEP * sd)
        errors = np.concatenate([np.zeros((1, sd.size)), columns, -columns])
        residual, samples, path = _residuals(plus(mean, errors), imu, poses, world)
        J = ((residual[1 : 1 + sd.size] - residual[1 + sd.size :]) / (2.0 * STEP * sd)[:, None]).T
        gyro, accel = _responses(samples, path, poses, float(mean["time_offset"]))
        density_w, density_a = density.gyro * mean["K_omega"], density.accel * mean["K_a"]
        S = _covariance(gyro, density_w) + _covariance(accel, density_a)
        S += np.diag(np.tile([poses.position_sd**2] * 3 + [poses.orientation_sd**2] * 3, poses.tau.size))
        weighted = np.linalg.solve(S, np.column_stack([J, residual[0]]))
        information = J.T @ weighted[:, :-1] + inverse
        slope = J.T @ weighted[:, -1] + inverse @ minus(mean, start)
        if total:
            slope[12:21] += _slope_of_covariance(gyro, weighted[:, -1], mean["K_omega"], density.gyro)
            slope[24:33] += _slope_of_covariance(accel, weighted[:, -1], mean["K_a"], density.accel)
        step = -np.linalg.solve(information, slope)
        mean = plus(mean, step)
        moved = float(np.abs(step * np.sqrt(np.diag(information))).max())
        if moved < 1e-3:
            break
    return Found(mean, np.linalg.inv(information), moved)


def _residuals(points: State, imu: Imu, poses: Poses, world: World) -> tuple[Array, Corrected, Trajectory]:
    """Return predicted minus measured poses (points, 6 m), in position and in the body's axes."""
    samples = correct(points, imu, 0, len(imu.stamps) - 1, alpha_points=5)
    _, path = propagate(points, samples, world)
    k = poses.samples
    g_r, earth_r = (x[:, None] for x in gravity_and_earth_rate(points, world))
    q, v, p = path.q[:, k], path.v[:, k], path.p[:, k]
    dt = (poses.tau[None] + np.ravel(points["time_offset"])[:, None] - samples.stamps[k])[..., None]
    rate = samples.omega[:, k] - quat.rotate_back(q, np.broadcast_to(earth_r, v.shape))
    force = quat.rotate(q, samples.f[:, k]) + g_r - 2.0 * np.cross(earth_r, v)
    attitude = quat.multiply(q, quat.exp(rate * dt + 0.5 * samples.alpha[:, k] * dt**2))
    position = p + v * dt + 0.5 * force * dt**2
    turn = quat.log(quat.multiply(quat.conjugate(np.broadcast_to(poses.quaternions, attitude.shape)), attitude))
    both = np.concatenate([position - poses.positions, turn], axis=-1)
    return both.reshape(len(both), -1), samples, path


def _responses(samples: Corrected, path: Trajectory, poses: Poses, offset: float) -> tuple[Array, Array]:
    """Return how poses answer to unit noise of corrected rates and forces, (6 m, n, 3) each, per root of an interval.

    A turn d of the body at one moment moves it later by the double integral of -[f_r x] d. Trapezoids are needed: the
    poses show a ten thousandth of that integral.
    """
    t, h = samples.stamps, np.gradient(samples.stamps)
    C, forces = quat.matrix(path.q[0]), quat.skew(quat.rotate(path.q[0], samples.f[0]))
    once, twice = (_integral(t, x) for x in (forces, forces * t[:, None, None]))
    gyro, accel = (np.zeros((poses.tau.size, 6, t.size, 3)) for _ in range(2))
    for j, (k, end) in enumerate(zip(poses.samples, poses.tau + offset, strict=True)):
        since = slice(0, k + 1)
        root = np.sqrt(h[since])[:, None, None]
        root[-1] *= 0.5 + (end - t[k]) / h[k]
        lever = end * (once[k] - once[since]) - (twice[k] - twice[since])
        gyro[j, :3, since] = np.moveaxis(-lever @ C[since] * root, 1, 0)
        gyro[j, 3:, since] = np.moveaxis(C[k].T @ C[since] * root, 1, 0)
        accel[j, :3, since] = np.moveaxis((end - t[since])[:, None, None] * C[since] * root, 1, 0)
    shape = (6 * poses.tau.size, t.size, 3)
    return gyro.reshape(shape), accel.reshape(shape)


def _integral(t: Array, x: Array) -> Array:
    steps = 0.5 * np.diff(t)[:, None, None] * (x[1:] + x[:-1])
    return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(steps, axis=0)])


def _covariance(response: Array, through: Array) -> Array:
    """Return the covariance of poses by noise that passes a matrix."""
    seen = (response @ through).reshape(len(response), -1)
    return np.asarray(seen @ seen.T)


def _slope_of_covariance(response: Array, weighted: Array, K: Array, density: float) -> Array:
    """Return the derivative of half the squared distance by a matrix, as far as it changes the covariance, (9,)."""
    shares = np.einsum("mni,m->ni", response, weighted)
    return np.asarray(-(density**2) * (shares.T @ shares @ K)).ravel()

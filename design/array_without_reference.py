"""Positions of the IMUs of a rigid array from its readings alone: an experiment for several IMUs at once.

Run: python design/array_without_reference.py RECORDING, a folder with imu0, imu1, … of equal stamps, turned by hand
with standstills and shaken. Each IMU is calibrated by its standstills first; positions are in the axes of imu0.

At every sample the acceleration of imu0, the angular acceleration, and how both change are unknowns of their own, so
that nothing is differentiated but for the start: rates squared alone give the scale. Each IMU reads at a moment of its
own, which its gyros show: the difference of its rates from the mean, along the angular acceleration.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.formats.loading import load
from kreisel.geometry.rotation import Array, exp, matrix, nearest_rotation
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static

MOVING = 1.0
"""rad/s of the mean rate from which on a sample is used."""

JERK, ANGULAR_JERK = 5e3, 6e4
"""m/s^3 and rad/s^3: usual sizes of what changes within a sample, as a prior."""

DELAY_SD, RATE_SD = 0.3e-3, 0.02
"""s and rad/s: by how much moments of reading differ, and what rates of one moment differ by."""

PRIORS = {"position": 1e3, "turn": 1e-2, "arm": 1e-3, "matrix": 2e-3, "lag": 5e-3}
"""Standard deviations: position (m), turn against the standstills (rad), position of one accelerometer against that of
its IMU (m), matrix, and lag of accelerometers behind gyros (s)."""

PASSES = 10


@dataclass(frozen=True)
class Moving:
    """Corrected readings of N IMUs in motion.

    `rates` (N, n, 3) are in the axes of imu0, `forces` (N, n, 3) in each one's own; `axes` (N, 3, 3) turns these to
    those of imu0. `slope` (n, 3) is the mean rates' derivative by differences, for the start.
    """

    seconds: Array
    rates: Array
    forces: Array
    axes: Array
    slope: Array


def main(folder: Path) -> None:
    """Print positions with deviations."""
    array = _read(folder)
    positions, deviations, left = estimate(array)
    print(f"{array.seconds.size} samples of motion, residual {left:.3f} m/s^2")
    for k, (p, sd) in enumerate(zip(1e3 * positions, 1e3 * deviations, strict=True)):
        print(f"imu{k}  {p[0]:8.3f} {p[1]:8.3f} {p[2]:8.3f} mm  +- {sd[0]:.3f} {sd[1]:.3f} {sd[2]:.3f}")


def _read(folder: Path) -> Moving:
    names = sorted(path.name for path in folder.glob("imu*") if path.is_dir())
    recordings = [load(folder, imu=name) for name in names]
    rests, seconds = find_rests(recordings[0].imu), recordings[0].imu.seconds
    rates, forces, clipped = [], [], np.zeros(seconds.size, bool)
    for recording in recordings:
        sensors, raw = calibrate_static(recording).calibration.sensors, recording.imu
        for values in (raw.rates, raw.accelerations):
            clipped |= (np.abs(values) >= 0.9995 * np.abs(values).max()).any(axis=1)
        rates.append((raw.rates + sensors.k_w[0]) @ sensors.K_omega.T)
        forces.append((raw.accelerations + sensors.k_a[0]) @ sensors.K_a.T)
    means = [[f[a:b].mean(axis=0) for a, b in zip(rests.first, rests.last, strict=True)] for f in forces]
    axes = np.array([nearest_rotation(np.array(means[0]).T @ np.array(own)) for own in means])
    seen = np.array([w @ R.T for w, R in zip(rates, axes, strict=True)])
    wide = clipped | np.roll(clipped, 1) | np.roll(clipped, -1)
    mean = seen.mean(axis=0)
    used = (np.linalg.norm(mean, axis=1) > MOVING) & ~wide
    slope = np.asarray(np.gradient(mean, seconds, axis=0))[used]
    return Moving(seconds[used], seen[:, used], np.array(forces)[:, used], axes, slope)


def estimate(array: Moving) -> tuple[Array, Array, float]:
    """Return positions and deviations (N, 3), m, relative to imu0, and the residual, m/s^2."""
    count, samples = array.rates.shape[:2]
    mean = array.rates.mean(axis=0)
    differences = array.rates - mean
    for k in range(count):  # what each IMU's matrix errs by against the mean's
        differences[k] -= mean @ np.linalg.lstsq(mean, differences[k], rcond=None)[0]
    layout = _Layout(count)
    theta, prior = np.zeros(layout.size), np.diag(layout.deviations**-2)
    alpha, variance = array.slope, 1.0
    weights: Array = np.ones(samples)
    for number in range(PASSES):
        delays = np.zeros((count, samples))
        if number > 1:
            delays = np.einsum("kmj,mj->km", differences, alpha) / (
                np.sum(alpha**2, axis=1) + (RATE_SD / DELAY_SD) ** 2
            )
            delays -= delays.mean(axis=0)
        H, J, y = _rows(array, mean, delays, alpha, theta, layout, changing=number > 1)
        if number == 0:  # the angular acceleration is taken as known
            y, H = y - (H[:, :, 3:] @ alpha[..., None])[..., 0], H[:, :, :3]
        N = np.swapaxes(H, 1, 2) @ H
        N[:, 6:, 6:] += variance * np.eye(max(0, H.shape[2] - 6))
        x = np.linalg.solve(N, np.swapaxes(H, 1, 2) @ y[..., None])
        residual = y - (H @ x)[..., 0]
        alpha = alpha if number == 0 else np.asarray(x[:, 3:6, 0], float)
        projected = J - H @ np.linalg.solve(N, np.swapaxes(H, 1, 2) @ J)
        scale = np.repeat(weights / variance, J.shape[1])[:, None]
        G = (J.reshape(-1, layout.size) * scale).T @ projected.reshape(-1, layout.size)
        scores = np.einsum("m,mij,mi->mj", weights / variance, projected, residual)
        theta = theta + np.linalg.solve(G + prior, scores.sum(axis=0) - prior @ theta)
        own = np.mean(residual**2, axis=1) * 3 * count / (3 * count - 9)
        weights = (
            4.0 / (3.0 + own / variance) if number > 3 else weights
        )  # Student's distribution, 3 degrees of freedom
        variance = float(np.average(own, weights=weights))
    blocks = np.floor(array.seconds).astype(int)
    sums = np.array([scores[blocks == block].sum(axis=0) for block in np.unique(blocks)])
    inverse = np.linalg.inv(G + prior)
    covariance = inverse @ (sums.T @ sums + prior) @ inverse
    D = layout.differences
    sd = np.sqrt(np.einsum("kij,jl,kil->ki", D, covariance, D))
    return D @ theta, sd, float(np.sqrt(variance))


class _Layout:
    """Where the parameters stand: position and turn of IMU 1 and up, arms and matrix of each, one lag."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.position = [slice(3 * (k - 1), 3 * k) if k else None for k in range(count)]
        at = 3 * (count - 1)
        self.turn = [slice(at + 3 * (k - 1), at + 3 * k) if k else None for k in range(count)]
        at *= 2
        self.arm = [[slice(at + 9 * k + 3 * j, at + 9 * k + 3 * j + 3) for j in range(3)] for k in range(count)]
        at += 9 * count
        self.matrix = [[slice(at + 9 * k + 3 * j, at + 9 * k + 3 * j + 3) for j in range(3)] for k in range(count)]
        self.lag = at + 9 * count
        self.size = self.lag + 1
        sizes = [3 * (count - 1), 3 * (count - 1), 9 * count, 9 * count, 1]
        self.deviations = np.repeat(list(PRIORS.values()), sizes)
        self.differences = np.zeros((count, 3, self.size))  # the mean of an IMU's accelerometers against that of imu0
        for k in range(1, count):
            self.differences[k][:, self.position[k]] = np.eye(3)
            for j in range(3):
                self.differences[k][:, self.arm[k][j]] += np.eye(3) / 3.0
                self.differences[k][:, self.arm[0][j]] -= np.eye(3) / 3.0

    def arm_of(self, theta: Array, k: int, j: int) -> Array:
        """Return the position of accelerometer j of IMU k."""
        own = self.position[k]
        return np.asarray(theta[self.arm[k][j]] + (0.0 if own is None else theta[own]))


def _rows(
    array: Moving, mean: Array, delays: Array, alpha: Array, theta: Array, layout: _Layout, *, changing: bool
) -> tuple[Array, Array, Array]:
    """Return what every sample's unknowns and the parameters do to the readings, and what is to be explained."""
    samples = mean.shape[0]
    H = np.zeros((samples, 3 * layout.count, 12 if changing else 6))
    J = np.zeros((samples, 3 * layout.count, layout.size))
    y = np.zeros((samples, 3 * layout.count))
    for k in range(layout.count):
        turn = layout.turn[k]
        axes = array.axes[k] @ (np.eye(3) if turn is None else matrix(exp(theta[turn])))
        omega = mean + (delays[k] + theta[layout.lag])[:, None] * alpha
        f = array.forces[k]
        for j in range(3):
            row, s, r = 3 * k + j, axes[:, j], layout.arm_of(theta, k, j)
            across = np.cross(r, s)
            H[:, row, :3], H[:, row, 3:6] = s, across
            if changing:
                H[:, row, 6:9] = delays[k][:, None] * s * JERK
                H[:, row, 9:] = delays[k][:, None] * across * ANGULAR_JERK
            centripetal = (omega @ s)[:, None] * omega - np.sum(omega**2, axis=1)[:, None] * s
            y[:, row] = f[:, j] + f @ theta[layout.matrix[k][j]] - centripetal @ r
            by_position = np.cross(s, alpha) + centripetal
            J[:, row, layout.arm[k][j]] = by_position
            if layout.position[k] is not None:
                J[:, row, layout.position[k]] = by_position
            J[:, row, layout.matrix[k][j]] = -f
            if turn is not None:
                J[:, row, turn] = np.cross(np.eye(3)[j], f)
            by_rate = (omega @ r)[:, None] * s + (omega @ s)[:, None] * r - 2.0 * (r @ s) * omega
            J[:, row, layout.lag] = np.sum(by_rate * alpha, axis=1)
    return H, J, y


if __name__ == "__main__":
    main(Path(sys.argv[1]))

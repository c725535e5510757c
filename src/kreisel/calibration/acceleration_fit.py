"""Accelerometers fitted to the reference without believing anything of them: for checks, not for first values.

The readings' double integrals over half seconds, seen with the reference's attitude, plus gravity, are the
second differences of the positions. With gravity's direction put on the other side, all else is linear, and
needs no belief about axes, signs or the unit of the positions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.calibration.setup import Preparation
from kreisel.geometry.rotation import Array

_LEAST_WINDOWS = 20


@dataclass(frozen=True)
class AccelerationFit:
    """What accelerations of IMU and reference say of each other.

    Attributes
    ----------
    K_a, K_a_sd : (3, 3)
        Cross-coupling of the accelerometers, whatever their order, signs and handedness.
    scale
        Bounds of the factor by which the positions are too large: noise in the positions makes the first too
        small, noise in all else the second too large. Zero and infinity where the motion does not show it.
    explained
        Share of gravity, as it moves through the readings, that is explained.
    agreement
        Of the accelerations felt, f, and shown, a: 1 - var(f - a) / (var f + var a).
    size
        Standard deviation of the larger of the two, m/s^2.
    """

    K_a: Array
    K_a_sd: Array
    scale: tuple[float, float]
    explained: float
    agreement: float
    size: float


def fit_accelerations(preparation: Preparation) -> AccelerationFit:
    """Return the fit of a recording with positions and orientations."""
    seen = preparation.force_fit.seen
    return _fit(seen.felt, seen.shown, preparation.site.gravity)


def _fit(felt: Array, shown: Array, gravity: float) -> AccelerationFit:
    """Fit, down-weighting windows that do not fit.

    Parameters
    ----------
    felt : (windows, 3, 15)
        What the accelerometers' nine couplings, three offsets and a common lever arm make.
    shown : (windows, 3)
        Accelerations of the reference.
    """
    if len(shown) < _LEAST_WINDOWS:
        return AccelerationFit(np.eye(3), np.full((3, 3), np.inf), (0.0, np.inf), 0.0, 1.0, 0.0)
    unknown = np.concatenate([felt, -shown[:, :, None]], axis=2)
    weight = np.ones(len(shown))
    for _ in range(8):
        fit = _homogeneous(unknown, weight, gravity)
        size = np.linalg.norm(fit.left, axis=1)
        weight = 1.0 / (1.0 + (size / (4.0 * float(np.median(size)) / 1.538 + 1e-9)) ** 2)
    x, sd = fit.x, fit.sd
    inverse, inverse_sd = x[15], sd[15]
    if inverse < -5.0 * inverse_sd or (abs(inverse) < 5.0 * inverse_sd and np.trace(x[:9].reshape(3, 3)) < 0.0):
        x, inverse = -x, -inverse
    moved = felt @ x[:15]
    agreement, amplitude = _agreement(moved, shown)
    high = 1.0 / inverse if inverse > 5.0 * inverse_sd else np.inf
    return AccelerationFit(
        K_a=x[:9].reshape(3, 3),
        K_a_sd=sd[:9].reshape(3, 3),
        scale=(_least_scale(felt, shown, weight, gravity), high),
        explained=fit.explained,
        agreement=agreement,
        size=amplitude,
    )


@dataclass(frozen=True)
class _Homogeneous:
    """Solution x (16,) of ``unknown x = -gravity``, its deviations, what is left, and the explained share."""

    x: Array
    sd: Array
    left: Array
    explained: float


def _homogeneous(unknown: Array, weight: Array, gravity: float) -> _Homogeneous:
    """Solve for gravity's direction, the least eigenvector of what nothing else explains, and for all else."""
    root = np.sqrt(weight)[:, None, None]
    M = (unknown * root).reshape(-1, unknown.shape[2])
    G = (np.broadcast_to(np.eye(3), (len(unknown), 3, 3)) * root).reshape(-1, 3)
    normal = M.T @ M
    normal += 1e-9 * np.diag(np.diag(normal) + 1e-12)
    x_of_g = -np.linalg.solve(normal, M.T @ G)
    rest = G + M @ x_of_g
    values, vectors = np.linalg.eigh(rest.T @ rest)
    g = gravity * vectors[:, 0]
    x = x_of_g @ g
    left = unknown @ x + g
    # windows overlap by half or more and share their noise
    variance = 2.0 * float(np.sum(weight[:, None] * left**2)) / (3.0 * float(weight.sum()))
    explained = 1.0 - float(values[0] / max(values[2], 1e-30))
    return _Homogeneous(x, np.sqrt(variance * np.diag(np.linalg.inv(normal))), left, explained)


def _least_scale(felt: Array, shown: Array, weight: Array, gravity: float) -> float:
    """Return gravity in the positions' unit over true gravity, fitted to the positions."""
    root = np.sqrt(weight)[:, None, None]
    A = (np.concatenate([felt, np.broadcast_to(np.eye(3), (len(shown), 3, 3))], axis=2) * root).reshape(-1, 18)
    solution, *_ = np.linalg.lstsq(A, (shown * root[:, :, 0]).reshape(-1), rcond=None)
    return float(np.linalg.norm(solution[15:])) / gravity


def _agreement(felt: Array, shown: Array) -> tuple[float, float]:
    felt, shown = felt - felt.mean(axis=0), shown - shown.mean(axis=0)
    total = float(np.mean(felt**2) + np.mean(shown**2))
    size = float(np.sqrt(max(np.mean(felt**2), np.mean(shown**2))))
    return 1.0 - float(np.mean((felt - shown) ** 2)) / max(total, 1e-30), size

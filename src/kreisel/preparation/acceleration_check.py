"""Fit of the accelerometers to the reference without assumptions about them: for checks, not for start values.

The readings' double integrals over half seconds, rotated by the reference's attitude, plus gravity, are the
second differences of the positions. With gravity's direction on the other side of the equation, everything else is
linear, and no assumption about axes, signs or the unit of the positions is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.estimation.robust import cauchy_weights, vector_scale
from kreisel.geometry.rotation import Array, lengths
from kreisel.preparation.preparation import Preparation
from kreisel.preparation.reference_noise import white_noise
from kreisel.synchronization.windows import variance_by_noise

_MIN_WINDOWS = 20
"""Windows of a fit. Chosen: their 60 equations are three times the 18 unknowns: couplings, offsets, lever arm, scale,
and direction of gravity."""

_SEPARABLE, _USUAL_NOISE = 0.05, 0.1
"""Deviation of the positions' scale up to which the motion tells accelerations from those of a lever arm, with this
noise of accelerations, m/s^2."""


_FAR_BETTER = 30.0
"""Factor between the squares that the second best and the best direction of gravity leave, above which it is known.
Chosen: it was 600 or more in 22 recordings, 14 or less in three of a short loop that does not show it."""

_CERTAIN, _LEFT = 0.9, 0.02
"""Share of the noise that is taken out, and of the squares of the reference's accelerations that is left at least.
Chosen: noise is known to a few per cent, and what is left makes only the second bound of the scale larger."""


@dataclass(frozen=True)
class AccelerationFit:
    """Comparison of the accelerations of IMU and reference.

    Attributes
    ----------
    K_a, K_a_sd : (3, 3)
        Cross-coupling of the accelerometers, whatever their order, signs and handedness.
    scale
        Bounds of the factor by which the positions are too large: noise in the positions makes the second too
        large, noise in all else the first too small. The second is three deviations larger, the first as much
        smaller where it is not surely above one. Zero and infinity where it, or the direction of gravity, is not
        observable.
    explained
        Share of gravity's change in the readings that is explained.
    agreement
        Of predicted accelerations, f, and reference ones, a, without the noise of poses in the latter:
        1 - var(f - a) / (var f + var a).
    size
        Standard deviation of the larger of the two without that noise, m/s^2.
    separable
        Whether the motion tells the reference's accelerations from those of a lever arm; a body that only turns about a
        point does not.
    signed
        Whether the positions show the sign of the couplings; else it is the one with a positive trace.
    """

    K_a: Array
    K_a_sd: Array
    scale: tuple[float, float]
    explained: float
    agreement: float
    size: float
    separable: bool = True
    signed: bool = True


def fit_accelerations(preparation: Preparation) -> AccelerationFit:
    """Return the fit of a recording with positions and orientations."""
    windows, reference = preparation.accelerometer_fit.windows, preparation.reference
    noise = variance_by_noise(reference.seconds, white_noise(reference)[0])
    return _fit(windows.regressor, windows.reference, preparation.site.gravity, noise)


def _fit(regressor: Array, reference: Array, gravity: float, noise: float = 0.0) -> AccelerationFit:
    """Fit, down-weighting windows that do not fit.

    Parameters
    ----------
    regressor : (windows, 3, 15)
        Predicted acceleration for a unit of nine couplings, three offsets and a common lever arm.
    reference : (windows, 3)
        Accelerations of the reference.
    noise
        Their variance by white noise of the poses, (m/s^2)^2.
    """
    if len(reference) < _MIN_WINDOWS:
        return AccelerationFit(np.eye(3), np.full((3, 3), np.inf), (0.0, np.inf), 0.0, 1.0, 0.0)
    unknown = np.concatenate([regressor, -reference[:, :, None]], axis=2)
    weight, counted = np.ones(len(reference)), _CERTAIN * noise
    for _ in range(8):
        fit = _homogeneous(unknown, weight, gravity, counted)
        size = lengths(fit.left)
        weight = cauchy_weights(size, 4.0 * vector_scale(size) + 1e-9)
        # large noise has small weight
        counted = _CERTAIN * noise * float(np.average(size**2, weights=weight)) / max(float(np.mean(size**2)), 1e-30)
    x, sd = fit.x, fit.sd
    inverse, inverse_sd = x[15], sd[15]
    signed = bool(abs(inverse) >= 5.0 * inverse_sd)
    if inverse < 0.0 if signed else np.trace(x[:9].reshape(3, 3)) < 0.0:
        x, inverse = -x, -inverse
    moved = regressor @ x[:15]
    agreement, amplitude = _agreement(moved, reference, noise)
    high = 1.0 / (inverse - 3.0 * inverse_sd) if inverse > 5.0 * inverse_sd and fit.sure else np.inf
    return AccelerationFit(
        K_a=x[:9].reshape(3, 3),
        K_a_sd=sd[:9].reshape(3, 3),
        scale=(_min_scale(regressor, reference, weight, gravity) if fit.sure else 0.0, high),
        explained=fit.explained,
        agreement=agreement,
        size=amplitude,
        separable=bool(inverse_sd / fit.noise * _USUAL_NOISE < _SEPARABLE),
        signed=signed,
    )


@dataclass(frozen=True)
class _Homogeneous:
    """Solution x (16,) of ``unknown x = -gravity``, its deviations, residuals and their deviation, explained share.

    sure: whether one direction of gravity fits far better than any other.
    """

    x: Array
    sd: Array
    left: Array
    explained: float
    noise: float
    sure: bool


def _homogeneous(unknown: Array, weight: Array, gravity: float, noise: float) -> _Homogeneous:
    """Solve for gravity's direction, the least eigenvector of the unexplained remainder, and for all else.

    Noise of the last column, the reference's accelerations, does not count as motion: else its factor would be too
    small, and the couplings would have to explain gravity with what is left.
    """
    root = np.sqrt(weight)[:, None, None]
    M = (unknown * root).reshape(-1, unknown.shape[2])
    G = (np.broadcast_to(np.eye(3), (len(unknown), 3, 3)) * root).reshape(-1, 3)
    normal = M.T @ M
    no_motion = min(3.0 * noise * float(weight.sum()), (1.0 - _LEFT) * normal[-1, -1])
    normal[-1, -1] -= no_motion
    normal += 1e-9 * np.diag(np.diag(normal) + 1e-12)
    x_of_g = -np.linalg.solve(normal, M.T @ G)
    remainder = G + M @ x_of_g
    values, vectors = np.linalg.eigh(remainder.T @ remainder - no_motion * np.outer(x_of_g[-1], x_of_g[-1]))
    g = gravity * vectors[:, 0]
    x = x_of_g @ g
    left = unknown @ x + g
    # windows overlap by half or more and share their noise
    variance = 2.0 * float(np.sum(weight[:, None] * left**2)) / (3.0 * float(weight.sum()))
    explained = 1.0 - float(values[0] / max(values[2], 1e-30))
    deviation = np.sqrt(variance * np.diag(np.linalg.inv(normal)))
    return _Homogeneous(x, deviation, left, explained, variance**0.5, bool(values[1] > _FAR_BETTER * values[0]))


def _min_scale(regressor: Array, reference: Array, weight: Array, gravity: float) -> float:
    """Return gravity in the positions' unit over true gravity, fitted to the positions.

    Where that is not surely above one, three deviations less.
    """
    root = np.sqrt(weight)[:, None, None]
    A = (np.concatenate([regressor, np.broadcast_to(np.eye(3), (len(reference), 3, 3))], axis=2) * root).reshape(-1, 18)
    accelerations = (reference * root[:, :, 0]).reshape(-1)
    solution, *_ = np.linalg.lstsq(A, accelerations, rcond=None)
    g, size = solution[15:], float(np.linalg.norm(solution[15:]))
    # windows overlap by half or more and share their noise
    variance = 2.0 * float(np.sum((accelerations - A @ solution) ** 2)) / (3.0 * float(weight.sum()))
    covariance = variance * np.linalg.pinv(A.T @ A)[15:, 15:]
    least = size - 3.0 * float(np.sqrt(g @ covariance @ g)) / max(size, 1e-30)
    return (size if least > gravity else least) / gravity


def _agreement(predicted: Array, reference: Array, noise: float = 0.0) -> tuple[float, float]:
    predicted, reference = predicted - predicted.mean(axis=0), reference - reference.mean(axis=0)
    differ = max(float(np.mean((predicted - reference) ** 2)) - noise, 0.0)
    squares = float(np.mean(predicted**2)), max(float(np.mean(reference**2)) - noise, 0.0)
    return 1.0 - differ / max(sum(squares), 1e-30), float(np.sqrt(max(squares)))

"""Standstills that all slowly turn about one axis of the device: an offset to its gyros, but not to gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.geometry.rotation import Array
from kreisel.static.multi_position import StaticEstimate
from kreisel.static.rest_noise import as_row, solution
from kreisel.static.rests import Rests

_FEWEST = 6
"""Standstills from which on a turn that they have in common is looked for."""

_CLEAR = 21.1
"""Chi-square with three degrees of freedom that is exceeded once in ten thousand times without any turn."""


def common_turn(rests: Rests) -> Array:
    """Return the rate at which all standstills turn, by gravity, about an axis of the device (3,), rad/s.

    Zero where the data do not show any. Each standstill shows what is across the vertical.
    """
    count = rests.count
    if count < _FEWEST:
        return np.zeros(3)
    up = rests.forces / np.linalg.norm(rests.forces, axis=1, keepdims=True)
    across = np.eye(3) - up[:, :, None] * up[:, None, :]
    shown = across.sum(axis=0)
    if np.linalg.cond(shown) > 1.0 / (np.finfo(float).eps * 1e4):
        return np.zeros(3)
    inverse = np.linalg.inv(shown)
    rate = inverse @ rests.turning.sum(axis=0)
    left = rests.turning - across @ rate
    covariance = inverse @ (left.T @ left) @ inverse * count / (count - 3)
    square = float(rate @ np.linalg.pinv(covariance) @ rate)
    # Hotelling's: by Bartlett's approximation of Wilks' lambda, chi-square
    return rate if (count - 2.5) * np.log1p(square / (count - 1)) > _CLEAR else np.zeros(3)


def effect_of(rate: Array, found: StaticEstimate) -> Array:
    """Return what a turn in common about each axis of the device, as fast as `rate`, does to the parameters, (P, 3)."""
    zero = np.zeros(found.problem.layout.degrees)
    if not rate.any():
        return np.zeros((zero.size, 3))
    figures = as_row(found.noise)

    def change(added: Array) -> Array:
        turned = replace(found.linear.rate, residual=found.linear.rate.residual + added)
        linear = replace(found.linear, rate=turned)
        return np.asarray(solution(found.problem, linear, found.weighing, figures, zero).parameters[0])

    usual = change(np.zeros(3))
    return np.column_stack([change(size * axis) - usual for size, axis in zip(rate, np.eye(3), strict=True)])

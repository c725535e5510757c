"""The sensor model of Fox and Janocha (2005), equations (1) and (2), completed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from kreisel.geometry.rotation import Array, skew

FORMULA = {
    "readings": (
        "d_w = g_sensitivity a' + g_squared a'^2, d_a = delay da'/dt - smoothing d^2a'/dt^2, and to either its "
        "asymmetry |x'| + cubic x'^3 + axis_delay dx'/dt - axis_smoothing d^2x'/dt^2 + temperature (T - T_0) + "
        "scale_temperature x' (T - T_0) with x' = w' or a' and T_0 = recording.temperature_c; all of the raw readings "
        "w' and a', element by element, each where the file has it"
    ),
    "angular_rate": "omega_ib_b = K_omega (w' + k_w0 + sum_i k_wi w'^i + d_w), powers element by element",
    "specific_force": (
        "f_b = K_a (a' + k_a0 + sum_i k_ai a'^i + d_a - e), e_j = s_j . ([alpha x] + [omega x]^2) r_j, "
        "s_j = row j of K_a^-1, r_j = row j of lever_arms, alpha = d omega/dt"
    ),
}
"""Equations from raw readings (primed) to true values; written into every result file."""


class SizeEffect(StrEnum):
    """Which form of the eccentricity term e of equation (2) is used."""

    COMPLETED = "completed"
    """e_j = s_j . ([alpha x] + [omega x]^2) r_j, inside the parentheses."""
    FOX2005 = "fox2005"
    """As printed: without products of rates, and added after K_a as if sensor and tool axes were the same."""


@dataclass(frozen=True)
class SensorParameters:
    """Parameters of equations (1) and (2), from readings to true values, SI.

    Attributes
    ----------
    K_omega, K_a : (3, 3)
        Cross-coupling matrices.
    k_w, k_a : (N, 3)
        Row 0 the offset k_0; row i the coefficient k_(i+1) of the power i + 1.
    lever_arms : (3, 3)
        Row j is the position r_j of accelerometer j in b, m.
    others
        Values of further effects, flat, by the names of their groups; see `inertial.effects`.
    """

    K_omega: Array
    k_w: Array
    K_a: Array
    k_a: Array
    lever_arms: Array
    others: Mapping[str, Array] = field(default_factory=dict)

    @property
    def effects(self) -> dict[str, Array]:
        """Values of all effects beyond offset and matrix, flat, by group: the polynomials and `others`."""
        powers = {"gyro_polynomial": self.k_w[1:].ravel(), "accel_polynomial": self.k_a[1:].ravel()}
        return {group: value for group, value in powers.items() if value.size} | dict(self.others)

    @classmethod
    def ideal(cls, order: int = 1) -> SensorParameters:
        """Return a sensor without errors, its axes those of b, with room for a polynomial of `order`."""
        zero = np.zeros((order, 3))
        return cls(np.eye(3), zero, np.eye(3), zero, np.zeros((3, 3)))


def check_parameters(parameters: SensorParameters) -> None:
    """Raise an error for parameters that no sensor has.

    Raises
    ------
    ValueError
        If one is not a finite number, or a matrix has no inverse.
    """
    p = parameters
    named = [("cross-coupling", p.K_omega), ("cross-coupling", p.K_a), ("offset or polynomial", p.k_w),
             ("offset or polynomial", p.k_a), ("lever arm", p.lever_arms), *p.others.items()]  # fmt: skip
    for name, values in named:
        if not np.isfinite(values).all():
            raise ValueError(f"a value of the {name} is not a finite number")
    for sensor, K in (("gyroscope", p.K_omega), ("accelerometer", p.K_a)):
        if not 1e-9 < abs(np.linalg.det(K)) < 1e9:
            raise ValueError(f"the cross-coupling matrix of the {sensor} has no inverse")


def correct_angular_rate(rates: Array, parameters: SensorParameters) -> Array:
    """Return the angular rate of b against inertial space (n, 3), rad/s, from readings without effects (n, 3).

    Notes
    -----
    Fox and Janocha (2005), equation (1); the sum in it is an effect, see `strapdown.without_effects`.
    """
    return np.asarray((rates + parameters.k_w[0]) @ parameters.K_omega.T)


def linear_columns(rates: Array, accelerations: Array, angular_accelerations: Array) -> Array:
    """Return what errors linear in a sensor's reading, and lever arms, are made of, (n, 16).

    Columns: one, rates, accelerations, angular accelerations (n, 3), and products of rates.
    """
    products = rate_products(rates)
    return np.column_stack([np.ones(len(rates)), rates, accelerations, angular_accelerations, products])


def rate_products(rates: Array) -> Array:
    """Return the products of two of the rates (n, 3), squares too: xx, xy, xz, yy, yz, zz, (n, 6)."""
    return np.column_stack([rates[:, i] * rates[:, k] for i in range(3) for k in range(i, 3)])


def size_effect(
    omega_b: Array,
    alpha_b: Array,
    parameters: SensorParameters,
    form: SizeEffect = SizeEffect.COMPLETED,
) -> Array:
    """Return the eccentricity term e (n, 3), m/s^2: equation (3) of docs/explanation/model.md.

    Parameters
    ----------
    omega_b, alpha_b : (n, 3)
        Angular rate (rad/s) and angular acceleration (rad/s^2) of b against inertial space.
    """
    W = skew(omega_b)
    square = W @ W
    if form is SizeEffect.FOX2005:
        square = square * np.eye(3)
    field = skew(alpha_b) + square
    axes = np.eye(3) if form is SizeEffect.FOX2005 else np.linalg.inv(parameters.K_a)
    return np.asarray(np.einsum("jk,nkl,jl->nj", axes, field, parameters.lever_arms))


def correct_specific_force(
    accelerations: Array,
    omega_b: Array,
    alpha_b: Array,
    parameters: SensorParameters,
    form: SizeEffect = SizeEffect.COMPLETED,
) -> Array:
    """Return the specific force at the origin of b (n, 3), m/s^2, from raw readings (n, 3).

    Parameters
    ----------
    accelerations, omega_b, alpha_b : (n, 3)
        Readings without effects (m/s^2), angular rate (rad/s) and angular acceleration (rad/s^2) of b.
    parameters
        Offset, cross-coupling and lever arms.
    form
        Which form of equation (2).

    Notes
    -----
    Fox and Janocha (2005), equation (2), completed with the products of rates that the printed form
    omits and with e measured along the sensitive axes.
    """
    y = accelerations + parameters.k_a[0]
    e = size_effect(omega_b, alpha_b, parameters, form)
    if form is SizeEffect.FOX2005:
        return np.asarray(y @ parameters.K_a.T - e)
    return np.asarray((y - e) @ parameters.K_a.T)

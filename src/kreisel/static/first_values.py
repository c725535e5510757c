"""First values from standstills, from no knowledge of the device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.errors import RecordingError
from kreisel.geometry.rotation import Array, lengths, right_angle_turns
from kreisel.inertial.sensor_model import SensorParameters
from kreisel.model.parameters import CellParameters
from kreisel.static.rest_problem import RestProblem, begun
from kreisel.static.spins import many_revolutions, uncounted, with_counted_spins
from kreisel.static.turns import turns_between

MIN_ATTITUDES = 6
"""Fewest standstills. Chosen: scale factors and offsets of three axes need six; fewer show nothing of their own."""

_ITERATIONS = 20
"""Steps of Gauss-Newton for the lengths of forces. Chosen: they settle in six."""

_MISFIT, _USUAL_K, _USUAL_OFFSET = 0.02, 0.05, 1.0
"""m/s^2, 1 and m/s^2: what is left of a force by first values, and usual deviations of K from one and of offsets."""

_FAR = 0.5
"""Distance of two unit vectors from which on it counts no more. Chosen: a turn that is read wrong must not decide, and
turns by half a circle, which fit four of the choices, may be more than half of all."""


_UNLIKE, _ALIKE = 0.2, 0.05
"""Mean misfit of turns from which another unit is tried, and below which it is the right one. Chosen: turns of gyros
that err by 3 % are 0.05 off, and those of no gyros 0.5."""

_UNITS = {
    180.0 / np.pi: "are they in rad/s, and not in deg/s?",
    np.pi / 180.0: "are they in deg/s, and not in rad/s?",
    1e-3: "are they in thousandths of the unit that is stated?",
    1e3: "are they in the unit of which thousandths are stated?",
}
"""Factors on rates of which the unit is another one than the stated, and what is asked then."""


def first_values(problem: RestProblem) -> CellParameters:
    """Return parameters by which all forces are about as long as gravity, and the gyros turned as the forces say.

    Raises
    ------
    RecordingError
        If there are too few standstills.
    """
    rests = problem.rests
    if rests.count < MIN_ATTITUDES:
        more = f" (at {rests.clipped} more a reading is at the end of its range)" if rests.clipped else ""
        raise RecordingError(
            f"{rests.count} standstills{more}, expected {MIN_ATTITUDES} or more in different attitudes, a dozen if "
            "possible", file=problem.imu.source,
        )  # fmt: skip
    K, k = _by_length(problem.rests.forces, problem.site.gravity)
    sensors = SensorParameters(np.eye(3), np.zeros((1, 3)), K, k[None], np.zeros((3, 3)))
    sensors = replace(sensors, k_w=-np.median(problem.rests.rates, axis=0)[None])
    up = (problem.rests.forces + k) @ K.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    best, misfit = _in_order(problem, sensors, up)
    if misfit > _UNLIKE:
        _check_unit(problem, sensors, up)
    return begun(with_counted_spins(problem, best), problem.site)


def _in_order(
    problem: RestProblem, sensors: SensorParameters, up: Array, factor: float = 1.0
) -> tuple[SensorParameters, float]:
    """Return the gyros, times a factor, in the order and with the sign that suit verticals (M, 3) best, and a misfit.

    That is the mean of `vertical_misfits`.
    """
    best, least, spins = sensors, np.inf, many_revolutions(problem, replace(sensors, K_omega=factor * np.eye(3)))
    other = np.setdiff1d(np.arange(len(up) - 1), spins)
    for sign in (factor, -factor):
        own = replace(sensors, K_omega=sign * np.eye(3))
        turns = turns_between(problem.imu, problem.raw, problem.rests, own)
        for Q in right_angle_turns():
            one = replace(sensors, K_omega=sign * Q)
            misfit = float(vertical_misfits(Q @ turns.rotations[other] @ Q.T, up[other], up[other + 1]).sum())
            if spins.size:  # where a turn of many revolutions leads, uncalibrated gyros do not know
                misfit += _FAR * uncounted(problem, one).size
            if misfit < least:
                best, least = one, misfit
    return best, least / (len(up) - 1)


def _check_unit(problem: RestProblem, sensors: SensorParameters, up: Array) -> None:
    """Raise an error for rates that agree with gravity once they are taken to be in another unit."""
    for factor, unit in _UNITS.items():
        if _in_order(problem, sensors, up, factor)[1] < _ALIKE:
            raise RecordingError(
                f"gravity turns {factor:.4g} times as far in the device as its rates say: {unit}; the header names the "
                "unit of each column", file=problem.imu.source,
            )  # fmt: skip


def vertical_misfits(rotations: Array, before: Array, after: Array) -> Array:
    """Return how far turns (m, 3, 3) lead from one vertical (m, 3) beside the next, (m,), at most `_FAR`."""
    seen = np.einsum("mkj,mk->mj", rotations, before)
    return np.minimum(lengths(seen - after), _FAR)


def _by_length(forces: Array, gravity: float) -> tuple[Array, Array]:
    """Return an upper triangular K (3, 3) and k (3,) with |K (a + k)| = g, from no errors on, by Gauss-Newton."""
    places = np.triu_indices(3)
    x = np.concatenate([np.eye(3)[places], np.zeros(3)])
    nominal = x.copy()
    held = np.diag((_MISFIT / np.repeat([_USUAL_K, _USUAL_OFFSET], [6, 3])) ** 2)  # what few attitudes do not show
    for _ in range(_ITERATIONS):
        K = np.zeros((3, 3))
        K[places] = x[:6]
        y = forces + x[6:]
        f = y @ K.T
        length = lengths(f)
        u = f / length[:, None]
        J = np.column_stack([*(u[:, i] * y[:, j] for i, j in zip(*places, strict=True)), u @ K])
        x = x + np.linalg.solve(J.T @ J + held, J.T @ (gravity - length) - held @ (x - nominal))
    return K, x[6:]

"""The equations of standstills and turns, linearised: gravity, the Earth's rotation, and rotations between standstills.

With K, k and d as in equations (1) and (2), C_m the attitude of standstill m (from b to the local level), a_m and w_m
its mean readings, and R_m the rotation by the gyros from its end to the beginning of the next one:

    a_m + k_a0 + c_m + d_a - K_a^-1 C_m^T (0, 0, -g)                            force
    w_m + k_w0 + b_m + d_w - K_omega^-1 C_m^T omega_ie                          rate
    log((exp(-omega_ie t_m) C_m R_m)^T C_(m+1))                                 turn

b and c are how far the offsets have walked from their values in the middle of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel._kernels.node_elimination import NODE
from kreisel.geometry.rotation import Array, Indices, exp, from_matrix, from_two_vectors, log, matrix, skew
from kreisel.inertial.effects import EFFECTS
from kreisel.model.parameters import CellParameters
from kreisel.static.rest_chain import ACCEL_WALK, ATTITUDE, GYRO_WALK, Equations
from kreisel.static.rest_problem import RestProblem
from kreisel.static.turns import Turns, turns_between


@dataclass(frozen=True)
class Linear:
    """All equations about some parameters and attitudes, and the turns they came from.

    Of turns across which samples are missing there are no equations.
    """

    force: Equations
    rate: Equations
    turn: Equations
    gyro_walk: Equations
    accel_walk: Equations
    known: tuple[Equations, ...]
    turns: Turns

    @property
    def all(self) -> tuple[Equations, ...]:
        """Every kind of equations, in the order of weights."""
        return self.force, self.rate, self.turn, self.gyro_walk, self.accel_walk, *self.known


def linearised(problem: RestProblem, p: CellParameters, C: Array) -> Linear:
    """Return the equations about parameters and attitudes C (M, 3, 3), from b to the local level.

    Notes
    -----
    By equations (32) and (33) of docs/explanation/model.md.
    """
    turns = turns_between(problem.imu, problem.raw, problem.rests, p.sensors)
    M = problem.rests.count
    every: Indices = np.arange(M)
    P = problem.layout.degrees
    return Linear(
        _force(problem, p, C, every),
        _rate(problem, p, C, every),
        _turn(problem, p, C, turns),
        _walk(M, GYRO_WALK, P),
        _walk(M, ACCEL_WALK, P),
        tuple(one.equations(problem, p, C) for one in problem.known),
        turns,
    )


def attitudes_by(problem: RestProblem, p: CellParameters, turns: Turns) -> Array:
    """Return attitudes (M, 3, 3) that are level by the forces, and turned against each other by the gyros."""
    up = _forces(problem, p)
    out = np.empty((len(up), 3, 3))
    C = np.eye(3)
    for m, force in enumerate(up):
        if m:
            C = out[m - 1] @ turns.rotations[m - 1]
        out[m] = matrix(from_two_vectors(C @ force, [0.0, 0.0, -1.0])) @ C
    return out


def moved(C: Array, change: Array) -> Array:
    """Return attitudes (M, 3, 3) turned by rotation vectors in b, (M, 3)."""
    return np.asarray(C @ matrix(exp(change)))


def earth_rate(problem: RestProblem, p: CellParameters) -> tuple[Array, Array]:
    """Return the Earth's rotation in the local level (3,), rad/s, and its derivatives by north and earth_down."""
    level, down = problem.site.earth_rate_units
    return np.array([*(level * p.north), down * p.earth_down]), np.diag([level, level, down])


def _forces(problem: RestProblem, p: CellParameters) -> Array:
    """Return the specific forces at standstills, (M, 3), by the parameters."""
    d = _added(problem, p, "accelerometer")
    return np.asarray((problem.rests.forces + p.sensors.k_a[0] + d) @ p.sensors.K_a.T)


def _added(problem: RestProblem, p: CellParameters, sensor: str) -> Array:
    """Return what effects add to the mean readings of a sensor, (M, 3)."""
    out = np.zeros((problem.rests.count, 3))
    for group, value in p.sensors.effects.items():
        if EFFECTS[group].sensor == sensor and np.any(value):
            out += problem.additions(group) @ value
    return out


def _effects(problem: RestProblem, p: CellParameters, sensor: str) -> dict[str, Array]:
    own = [g for g in p.sensors.effects if EFFECTS[g].sensor == sensor and g in problem.layout]
    return {group: problem.additions(group) for group in own}


def _force(problem: RestProblem, p: CellParameters, C: Array, every: Indices) -> Equations:
    inverse = np.linalg.inv(p.sensors.K_a)
    up = -C[:, 2]  # C^T (0, 0, -1)
    seen = p.gravity * up @ inverse.T
    by_group = {
        "accel_cross_coupling": np.einsum("ij,ml->mijl", inverse, seen).reshape(-1, 3, 9),
        "accel_offset": np.broadcast_to(np.eye(3), (len(C), 3, 3)),
        "gravity": -(up @ inverse.T)[:, :, None],
        **_effects(problem, p, "accelerometer"),
    }
    J = np.zeros((len(C), 3, NODE))
    J[..., ATTITUDE] = -inverse @ skew(p.gravity * up)
    J[..., ACCEL_WALK] = np.eye(3)
    r = problem.rests.forces + p.sensors.k_a[0] + _added(problem, p, "accelerometer") - seen
    return Equations(r, every, J, None, problem.columns(by_group, len(C)))


def _rate(problem: RestProblem, p: CellParameters, C: Array, every: Indices) -> Equations:
    inverse = np.linalg.inv(p.sensors.K_omega)
    omega, D = earth_rate(problem, p)
    rate = np.einsum("mji,j->mi", C, omega)
    seen = rate @ inverse.T
    by_earth = -inverse @ np.swapaxes(C, 1, 2) @ D
    by_group = {
        "gyro_cross_coupling": np.einsum("ij,ml->mijl", inverse, seen).reshape(-1, 3, 9),
        "gyro_offset": np.broadcast_to(np.eye(3), (len(C), 3, 3)),
        "north": by_earth[:, :, :2],
        "earth_down": by_earth[:, :, 2:],
        **_effects(problem, p, "gyroscope"),
    }
    J = np.zeros((len(C), 3, NODE))
    J[..., ATTITUDE] = -inverse @ skew(rate)
    J[..., GYRO_WALK] = np.eye(3)
    r = problem.rests.rates + p.sensors.k_w[0] + _added(problem, p, "gyroscope") - seen
    return Equations(r, every, J, None, problem.columns(by_group, len(C)))


def _turn(problem: RestProblem, p: CellParameters, C: Array, turns: Turns) -> Equations:
    at = np.setdiff1d(np.flatnonzero(turns.whole), problem.unused)
    omega, D = earth_rate(problem, p)
    seconds, R = turns.seconds[at], turns.rotations[at]
    before, after = C[at], C[at + 1]
    expected = matrix(exp(-omega * seconds[:, None])) @ before @ R
    r = log(from_matrix(np.swapaxes(expected, 1, 2) @ after))
    by_earth = np.swapaxes(before @ R, 1, 2) @ D * seconds[:, None, None]
    by_group = {group: -J[at] for group, J in turns.derivatives.items()}
    by_group |= {"north": by_earth[:, :, :2], "earth_down": by_earth[:, :, 2:]}
    own, following = np.zeros((at.size, 3, NODE)), np.zeros((at.size, 3, NODE))
    own[..., ATTITUDE] = -np.swapaxes(R, 1, 2)
    following[..., ATTITUDE] = np.eye(3)
    own[..., GYRO_WALK] = following[..., GYRO_WALK] = 0.5 * by_group["gyro_offset"]
    return Equations(r, at, own, following, problem.columns(by_group, at.size))


def _walk(M: int, part: slice, P: int) -> Equations:
    """Return that offsets at the next standstill differ from those at this one by a random walk alone."""
    J = np.zeros((M - 1, 3, NODE))
    J[..., part] = np.eye(3)
    return Equations(np.zeros((M - 1, 3)), np.arange(M - 1), -J, J, np.zeros((M - 1, 3, P)))

"""The models' derivatives, against complex steps of the book's: exact to rounding, and of equations written apart."""

import numpy as np

from kreisel.estimation.sigma_points import DERIVATIVES
from kreisel.kalman.filter_pass import run_filter
from kreisel.kalman.run_slopes import Slopes

from ..oracle import plain_filter
from ..oracle.quaternions import conjugate, exp, multiply
from ..oracle_case import EARTH_N, GRAVITY, GROUPS, Case, problem_and_belief

STEP = 1e-30
"""Imaginary: its square is nothing beside one, so that no digit is lost."""


def by_complex_steps(case, state, samples, tau, name):
    """Return the derivatives (15, n) by a part of the state: velocity, position, attitude; then of the pose."""
    world = plain_filter.World(GRAVITY, EARTH_N)
    points = {key: np.asarray(value, dtype=complex)[None] for key, value in state.items()}
    if name in plain_filter.ATTITUDES:
        changed = [multiply(points[name][0], exp(1j * STEP * axis)) for axis in np.eye(3)]
    else:
        size = points[name][0].size
        changed = [points[name][0] + 1j * STEP * unit.reshape(points[name][0].shape) for unit in np.eye(size)]
    imu = plain_filter.Imu(case.t, case.rates, case.forces)
    columns = []
    for value in changed:
        own = points | {name: value[None]}
        moved, _ = plain_filter.propagate(own, plain_filter.correct(own, imu, *samples, alpha_points=5), world)
        last = plain_filter.correct(moved, imu, samples[1], samples[1], alpha_points=5)
        position, attitude = plain_filter.predict_pose(moved, last, tau, world)
        parts = (moved["v"][0], moved["p"][0], turn(moved["q_rb"][0]), position[0], turn(attitude[0]))
        columns.append(np.concatenate(parts))
    return np.stack(columns, axis=1).imag / STEP


def turn(q):
    """Return a rotation vector whose imaginary part is the small turn, on the right, that a complex step made."""
    return 2.0 * multiply(conjugate(q.real), q)[1:]


def test_derivatives_are_those_of_complex_steps():
    """Of every parameter and of navigation, at the fifth update: largest difference over the largest derivative."""
    case = Case(3)
    problem, belief = problem_and_belief(case, "central-difference")
    layout, slopes = problem.layout, Slopes(problem, np.arange(problem.layout.degrees))
    run_filter(problem, problem.prior.start, belief=belief, gate=np.inf, slopes=slopes, points=DERIVATIVES)
    at = 4
    (own,) = slopes.stretches(at, at + 1)
    mean, whitening = own.mean[0], own.whitening[0]
    state = {GROUPS[name]: mean[layout.stored(name)] for name in GROUPS}
    state |= {key: np.reshape(value, plain_filter.SHAPES[key]) for key, value in state.items()}
    update = problem.schedule.updates[at]
    pose = np.linalg.solve(whitening[:6, :6], own.tables.design[0, :6])
    ours = np.concatenate([own.tables.transition[0, -9:], pose])
    worst = {}
    for name, theirs in GROUPS.items():
        if name == "alignment":
            continue
        wanted = by_complex_steps(case, state, (update.first, update.last), update.tau, theirs)
        found = ours[:, layout[name]]
        worst[name] = max(
            np.abs(found[rows] - wanted[rows]).max() / max(np.abs(wanted[rows]).max(), 1e-12)
            for rows in (slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15))
        )
    print(worst)
    assert max(worst.values()) < 1e-3

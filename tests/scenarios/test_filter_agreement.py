"""The engine against a filter written from the book, and its choices of sigma points against each other."""

import numpy as np
import pytest

from kreisel.kalman.filter_pass import run_filter

from ..oracle import plain_filter
from ..oracle_case import EARTH_N, GRAVITY, Case, book_covariance, compare, problem_and_belief


def ours(case, weights):
    problem, belief = problem_and_belief(case, weights)
    return problem.layout, run_filter(problem, problem.prior.start, gate=np.inf, belief=belief)


def book(case, weights, order=None):
    s = case.setup
    poses = [(float(tau), p, q) for tau, p, q in zip(case.tau, case.positions, case.quaternions, strict=True)]
    return plain_filter.run(
        case.t,
        case.rates,
        case.forces,
        poses,
        [int(k) for k in case.samples],
        case.start,
        book_covariance(case),
        s.gyro,
        s.accel,
        s.position,
        s.orientation,
        GRAVITY,
        EARTH_N,
        start_index=s.every,
        weights=weights,
        drawing_order=order,
        alpha_points=5,
    )


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("weights", ["central-difference", "unscented"])
def test_engine_and_book_agree(seed, weights):
    """Same readings, same prior: the book redraws its points before the update and keeps covariances.

    What may differ is of second order in the prior's deviations; ten times what was measured is allowed.
    """
    case = Case(seed)
    layout, run = ours(case, weights)
    mean, spread = compare(layout, run, book(case, "central" if weights == "central-difference" else weights))
    print(f"seed {seed} {weights}: means differ by {mean:.2g} sd, deviations by {spread:.2g}")
    assert mean < 0.02
    assert spread < 1e-3


def test_choices_of_sigma_points_agree():
    case = Case(2)
    runs = {name: ours(case, name) for name in ("central-difference", "unscented", "linear")}
    layout, reference = runs["central-difference"]
    sd = reference.belief.standard_deviation
    for name in ("unscented", "linear"):
        other = runs[name][1]
        difference = layout.minus(other.belief.mean[:, None], reference.belief.mean)[:, 0] / sd
        assert np.abs(difference).max() < 0.1, name
        assert np.abs(other.belief.standard_deviation / sd - 1.0).max() < 0.02, name


def test_errors_are_as_large_as_the_filter_says():
    """NEES of the 37 parameters over eight runs: mean inside the 99.9 % interval of chi-square."""
    from scipy.stats import chi2

    total, degrees = 0.0, 0
    for seed in range(8):
        case = Case(100 + seed)
        layout, run = ours(case, "central-difference")
        t = case.truth
        error = []
        for group, value in (
            ("gyro_cross_coupling", t["K_omega"]),
            ("gyro_offset", t["k_w"][0]),
            ("accel_cross_coupling", t["K_a"]),
            ("accel_offset", t["k_a"][0]),
            ("lever_arms", t["lever_arms"]),
        ):
            error.append(run.belief.mean[layout.stored(group)] - np.ravel(value))
        error = np.concatenate(error)
        n = error.size
        total += float(error @ np.linalg.solve(run.belief.covariance[:n, :n], error))
        degrees += n
    low, high = chi2.ppf([5e-4, 1 - 5e-4], degrees)
    print(f"NEES {total / degrees:.3f} per degree, bounds {low / degrees:.3f} to {high / degrees:.3f}")
    assert low < total < high

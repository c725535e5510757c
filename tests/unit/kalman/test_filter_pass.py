"""What happens between two updates of a run, against the same done by hand."""

from dataclasses import replace

import numpy as np

from kreisel.estimation.belief import Belief
from kreisel.kalman.filter_pass import run_filter

from ...small_problem import random_belief, small_problem


def with_updates(problem, updates, begin):
    attitude = problem.schedule.attitude[begin : begin + len(updates)]
    return replace(problem, schedule=replace(problem.schedule, updates=tuple(updates), attitude=attitude))


def test_the_references_error_is_a_new_one_at_each_standstill():
    problem = small_problem()
    updates, start = problem.schedule.updates, problem.prior.start
    at = next(i for i, update in enumerate(updates) if update.new_standstill and i > 3)
    step = updates[at]
    belief = random_belief(problem, np.random.default_rng(1))
    mean = belief.mean.copy()
    mean[problem.layout.stored("standstill_position")] = 1e-3
    belief = replace(belief, mean=mean)
    by_itself = run_filter(with_updates(problem, [step], at), start, gate=np.inf, belief=belief)
    mean, P = belief.mean.copy(), belief.covariance
    for name, deviation in zip(
        ("standstill_position", "standstill_orientation"), problem.noise.standstill_error, strict=True
    ):
        mean[problem.layout.stored(name)] = 0.0
        P[problem.layout[name], :] = P[:, problem.layout[name]] = 0.0
        P[problem.layout[name], problem.layout[name]] = deviation**2 * np.eye(3)
    belief = Belief(mean, np.linalg.cholesky(P))
    told = with_updates(problem, [replace(step, new_standstill=False)], at)
    by_hand = run_filter(told, start, gate=np.inf, belief=belief)
    scale = by_hand.belief.standard_deviation
    apart = problem.layout.minus(by_itself.belief.mean[:, None], by_hand.belief.mean)[:, 0]
    assert np.abs(apart / scale).max() < 1e-6
    correlated = np.abs(by_itself.belief.covariance - by_hand.belief.covariance) / np.outer(scale, scale)
    assert correlated.max() < 1e-8

"""Fits of the first part of a recording from a linearised run, against runs of that part."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.fitting.partition import block_ends, nearest_end
from kreisel.inverse.inverse_filter import InverseFilter
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import part_of

from ...small_problem import camera_problem, estimate_of, with_noise


@pytest.fixture(scope="module")
def settled():
    problem = camera_problem()
    return problem, KalmanFilter().refit(problem, KalmanFilter().fit(problem))


@pytest.mark.parametrize("walk", [0.0, 1e-5])
def test_the_first_updates_say_what_a_run_of_them_says(settled, walk):
    problem, run = settled
    problem = with_noise(problem, offset_walk={"gyro_offset": walk, "accel_offset": 0.0})
    linear = KalmanFilter().linearise(problem, run)
    n = len(problem.parameter_names)
    for count in block_ends(problem)[1:]:
        found, want = linear.first(count), KalmanFilter().refit(part_of(problem, slice(0, count)), run)
        deviation = want.belief.standard_deviation[:n]
        off = problem.layout.minus(found.belief.mean[:, None], want.belief.mean)[:n, 0]
        np.testing.assert_allclose(off / deviation, 0.0, atol=1e-6)
        np.testing.assert_allclose(found.belief.standard_deviation[:n], deviation, rtol=1e-6)
        np.testing.assert_array_equal(found.history.used, want.history.used)


def test_only_the_end_of_a_block_is_known(settled):
    problem, run = settled
    linear = KalmanFilter().linearise(problem, run)
    assert linear.first(block_ends(problem)[1] + 1) is None


def test_a_gate_that_leaves_out_updates_takes_another_run(settled):
    problem, run = settled
    linear = KalmanFilter().linearise(problem, replace(run, gate=1e-3))
    count = block_ends(problem)[1]
    assert linear.first(count) is None
    found = estimate_of(problem, run, linear=linear).first(count)
    want = KalmanFilter().refit(part_of(problem, slice(0, count)), run)
    np.testing.assert_array_equal(found.belief.mean, want.belief.mean)


def test_a_fit_by_predicted_readings_takes_another_run(settled):
    problem, run = settled
    inverse = InverseFilter(KalmanFilter())
    assert inverse.linearise(problem, inverse.refit(problem, run)).first(block_ends(problem)[1]) is None


def test_the_nearest_end_leaves_enough_updates():
    problem = camera_problem()
    ends, count = block_ends(problem), len(problem.schedule.updates)
    assert nearest_end(problem, ends[2] + 1) == ends[2]
    assert nearest_end(problem, count, count - ends[-2]) == ends[-2]
    assert nearest_end(problem, 7, count) == 7

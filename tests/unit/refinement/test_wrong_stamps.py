"""Poses whose stamps are wrong, by innovations that are made up."""

from dataclasses import replace

import numpy as np

from kreisel.fitting.fit import Fit
from kreisel.refinement.wrong_stamps import with_wrong_stamps, wrong_stamps_warning

from ...small_problem import history, small_problem, with_noise

USUAL, WRONG = 4e-3, 30e-3
OWN = 3e-3
"""Deviation of a stamp's error by an innovation beside its own noise."""


def noisy():
    problem = small_problem()
    return with_noise(problem, reference=replace(problem.noise.reference, stamp=USUAL))


def run_with(problem, error):
    poses = problem.schedule.poses
    own = problem.noise.stamp_deviations(poses)
    late = np.column_stack([error, np.hypot(OWN, own)])
    return Fit(None, None, None, history(poses.size, late=late), 0.0)


def test_a_wrong_stamp_gets_a_deviation_of_its_own_and_loses_it_again():
    problem = noisy()
    error = np.zeros(problem.schedule.poses.size)
    assert with_wrong_stamps(problem, run_with(problem, error)) is problem
    error[7] = WRONG
    marked = with_wrong_stamps(problem, run_with(problem, error))
    deviations = marked.noise.stamp_deviations(problem.schedule.poses)
    assert deviations[7] == problem.reference.interval
    assert np.all(np.delete(deviations, 7) == USUAL)
    assert with_wrong_stamps(marked, run_with(marked, error)) is marked
    error[7] = 3.0 * np.hypot(OWN, USUAL)  # between the two bounds: as it was
    assert with_wrong_stamps(marked, run_with(marked, error)) is marked
    error[7] = USUAL
    again = with_wrong_stamps(marked, run_with(marked, error))
    assert np.all(again.noise.stamp_deviations(problem.schedule.poses) == USUAL)


def test_where_many_stamps_seem_wrong_something_else_is():
    problem = noisy()
    error = np.zeros(problem.schedule.poses.size)
    error[::3] = WRONG
    assert with_wrong_stamps(problem, run_with(problem, error)) is problem


def test_good_stamps_are_never_wrong():
    problem = with_noise(small_problem(), reference=replace(small_problem().noise.reference, stamp=0.0))
    error = np.zeros(problem.schedule.poses.size)
    error[7] = WRONG
    assert with_wrong_stamps(problem, run_with(problem, error)) is problem


def test_the_warning_counts_the_poses_that_are_used():
    problem = noisy()
    assert wrong_stamps_warning(problem) == []
    stamps = np.full(problem.reference.stamps_ns.size, USUAL)
    stamps[problem.schedule.poses[[3, 8]]] = WRONG
    (warning,) = wrong_stamps_warning(with_noise(problem, stamps=stamps))
    assert "2 of the poses" in str(warning)

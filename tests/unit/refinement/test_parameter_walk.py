"""Scores of random walks: by chance where nothing walks, far beyond it where something does."""

import numpy as np
import pytest

from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.parameters import WALKING_GROUPS
from kreisel.model.problem import with_readings
from kreisel.refinement.parameter_walk import may_walk

from ...small_problem import camera_problem

ESTIMATOR = KalmanFilter()


def linearised(problem):
    return problem, ESTIMATOR.linearise(problem, ESTIMATOR.refit(problem, ESTIMATOR.fit(problem)))


def walking(field, size):
    """The problem with offsets of a sensor that walk by so much from the first sample to the last."""
    problem = camera_problem()
    readings = problem.sensor.readings
    steps = np.random.default_rng(3).normal(size=readings.rates.shape) * size / len(readings.rates) ** 0.5
    changed = readings.with_values(**{field: getattr(readings, field) + np.cumsum(steps, axis=0)})
    return with_readings(problem, changed)


def test_nothing_walks_in_a_sound_recording():
    problem, linear = linearised(camera_problem())
    assert not may_walk(problem, linear)
    for group in WALKING_GROUPS:
        score = linear.walk_score(group)
        assert score.value[0] < np.quantile(score.draws, 0.98) + score.draws.std()


@pytest.mark.parametrize(("field", "size", "group"), [("rates", 2e-3, 0), ("accelerations", 0.2, 1)])
def test_a_walk_is_noticed_in_its_own_score(field, size, group):
    problem, linear = linearised(walking(field, size))
    assert may_walk(problem, linear)
    score = linear.walk_score(WALKING_GROUPS[group])
    assert score.value[0] > score.draws.mean() + 10.0 * score.draws.std()

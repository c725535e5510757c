"""Every second update left out: what remains covers the same motion, and another answer widens the deviations."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.interval_check import interval_disagreement
from kreisel.estimation.belief import Belief
from kreisel.estimation.uncertainty import scaling
from kreisel.estimation.uncertainty_budget import Source
from kreisel.model.problem import with_rarer_updates

from ...small_problem import GivenFits, camera_problem, estimate_of, small_problem, small_run


@pytest.mark.parametrize("problem", [small_problem, camera_problem])
def test_rarer_updates_cover_the_same_motion_and_keep_standstills(problem):
    before, after = (one.schedule for one in (problem(), with_rarer_updates(problem())))
    assert after.interval == 2.0 * before.interval
    assert after.attitude.shape == (len(after.updates), 4)
    assert after.updates[-1].last == before.updates[-1].last
    assert after.updates[0].first == before.updates[0].first
    for a, b in zip(after.updates, after.updates[1:], strict=False):
        assert b.new_segment or b.first == a.last
    still = [u.pose for u in before.updates if u.standstill is not None]
    assert [u.pose for u in after.updates if u.standstill is not None] == still
    path = [sum(u.standstill is None for u in one.updates) for one in (before, after)]
    assert 0.45 * path[0] < path[1] < 0.75 * path[0]


def other_answer(deviations, factor):
    """An estimate whose gyro offsets a run with rarer updates finds elsewhere, so many of its deviations away."""
    problem, run = small_problem(), small_run()
    larger = scaling("correlated innovations", Source.PATH, run.belief.factor, factor)
    found = estimate_of(problem, run, correlation_factor=factor).adding([larger])
    change = np.zeros(problem.layout.degrees)
    offset = problem.layout["gyro_offset"]
    change[offset] = deviations * found.deviation[offset]
    mean = problem.layout.plus(run.belief.mean, change[:, None])[:, 0]
    wider = replace(run, belief=Belief(mean, 1.2**0.5 * run.belief.factor))
    more = interval_disagreement(replace(found, estimator=GivenFits([wider])))
    return found, found.adding(more.contributions, more.warnings)


def test_another_answer_widens_by_the_difference():
    """The variance of the difference is 0.2 of the estimate's: 3 deviations are 6.7 of the difference."""
    found, checked = other_answer(3.0, 1.5)
    scale = checked.deviation / found.deviation
    offset = found.problem.layout["gyro_offset"]
    np.testing.assert_allclose(scale[offset], 10.0**0.5, rtol=1e-6)
    np.testing.assert_allclose(np.delete(scale, np.r_[offset]), 1.0, rtol=1e-9)
    assert "gyro_offset 3.2" in checked.warnings[-1].message


def test_differences_by_chance_and_white_innovations_change_nothing():
    for deviations, factor in ((0.8, 1.5), (3.0, 1.0)):
        found, checked = other_answer(deviations, factor)
        assert checked.contributions == found.contributions
        assert checked.warnings == ()

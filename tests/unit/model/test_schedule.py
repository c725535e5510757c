"""A problem's schedule, as the classes describe it: held against plain searches over all poses and samples."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kreisel.errors import SynchronizationError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.schedule import MIN_UPDATES
from kreisel.preparation.build_problem import build_problem

from ...small_problem import prepared, small_problem


def test_each_update_begins_where_the_one_before_ended():
    updates = small_problem().schedule.updates
    assert updates[0].new_segment
    assert updates[0].first == updates[0].last
    for before, update in pairwise(updates):
        assert not update.new_segment
        assert before.last == update.first < update.last
        assert before.tau < update.tau


def test_a_pose_is_used_at_the_sample_nearest_to_it():
    problem = small_problem()
    t, reference = problem.sensor.readings.stamps, problem.reference
    for update in problem.schedule.updates:
        assert update.tau == reference.seconds[update.pose]
        at = problem.schedule.clock.imu_time(update.tau)
        assert abs(t[update.last] - at) == np.min(np.abs(t - at))


def test_updates_lie_an_interval_apart():
    """Each is the pose nearest to its place on a grid, and so at most half a pose interval from it."""
    schedule = small_problem().schedule
    tau = np.array([update.tau for update in schedule.updates])
    grid = tau[0] + schedule.interval * np.arange(tau.size)
    assert np.abs(tau - grid).max() <= 0.5 * small_problem().reference.interval + 1e-9


def test_standstills_are_those_the_poses_lie_in_and_each_begins_once():
    problem = small_problem()
    schedule, seen = problem.schedule, []
    for update in schedule.updates:
        t = schedule.clock.imu_time(update.tau)
        within = [i for i, s in enumerate(schedule.standstills) if s.start <= t <= s.stop]
        assert within == ([] if update.standstill is None else [update.standstill])
        assert update.new_standstill == (update.standstill is not None and update.standstill not in seen)
        seen += within
    assert len(set(seen)) >= 8  # the small cell rests every four seconds


def test_a_gap_in_the_readings_begins_navigation_anew():
    preparation = prepared()
    n = preparation.readings.stamps.size
    readings = replace(preparation.readings, segments=((0, 1499), (1600, n - 1)))
    updates = build_problem(replace(preparation, readings=readings), CalibrationSettings()).schedule.updates
    anew = [update for update in updates if update.new_segment]
    assert len(anew) == 2
    assert anew[1].first == anew[1].last >= 1600
    assert all(update.last < 1500 or update.first >= 1600 for update in updates)


def test_fewer_updates_than_the_least_are_refused():
    interval = prepared().reference.seconds[-1] / (MIN_UPDATES - 1.8)
    enough = CalibrationSettings(update_interval=0.8 * interval)
    assert len(build_problem(prepared(), enough).schedule.updates) >= MIN_UPDATES
    with pytest.raises(SynchronizationError, match=rf"only {MIN_UPDATES - 1} updates of .* expected {MIN_UPDATES}"):
        build_problem(prepared(), CalibrationSettings(update_interval=interval))

"""Updates chosen from poses, against a search written out, and hand-made cases."""

from pathlib import Path

import numpy as np

from kreisel.inertial.readings import Readings
from kreisel.model.standstill import Standstill
from kreisel.preparation.scheduling import schedule_updates
from kreisel.recording.recording import ReferencePoses

STEP = 0.0025


def readings_of(stamps, segments=None):
    zero = np.zeros((stamps.size, 3))
    return Readings(stamps, zero, zero, segments or ((0, stamps.size - 1),))


def even_readings(seconds=10.0):
    return readings_of(np.arange(round(seconds / STEP) + 1) * STEP)


def poses_at(tau, doubtful=None):
    stamps = np.round(1e9 * np.asarray(tau)).astype(np.int64)
    return ReferencePoses("pose0", stamps, None, None, Path("pose0/data.csv"), doubtful=doubtful)


def chosen_by_search(t_pose, inside, interval):
    """Of each moment of the grid the nearest pose, if it lies within half an interval."""
    found, moment = [], t_pose[inside[0]]
    while moment <= t_pose[inside[-1]] + 0.5 * interval:
        near = inside[np.argmin(np.abs(t_pose[inside] - moment))]
        if abs(t_pose[near] - moment) <= 0.5 * interval and near not in found:
            found.append(near)
        moment += interval
    return found


def test_every_fortieth_of_even_poses_is_used():
    tau = np.arange(0.0, 8.7, 0.012)
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau), (), 0.48)
    assert [u.pose for u in updates] == list(range(0, tau.size, 40))
    np.testing.assert_allclose([u.tau for u in updates], tau[::40])
    np.testing.assert_allclose([STEP * u.last for u in updates], 0.5 + tau[::40], atol=0.5 * STEP + 1e-9)
    assert [u.standstill for u in updates] == [None] * len(updates)
    assert not any(u.new_standstill for u in updates)


def test_uneven_poses_are_those_nearest_to_the_grid_and_samples_those_nearest_to_them():
    rng = np.random.default_rng(2)
    stamps = np.cumsum(rng.uniform(0.002, 0.003, 4000))
    tau = np.cumsum(rng.exponential(0.03, 300))
    t_pose = 0.3 + 1.001 * tau
    updates = schedule_updates(readings_of(stamps), t_pose, poses_at(tau), (), 0.1)
    inside = np.flatnonzero((t_pose > stamps[1]) & (t_pose < stamps[-2]))
    assert [u.pose for u in updates] == chosen_by_search(t_pose, inside, 0.1)
    assert [u.last for u in updates] == [int(np.argmin(np.abs(stamps - t_pose[u.pose]))) for u in updates]


def test_the_motion_is_integrated_from_update_to_update():
    tau = np.arange(0.0, 9.0, 0.012)
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau), (), 0.24)
    assert (updates[0].first, updates[0].new_segment) == (updates[0].last, True)
    assert [u.first for u in updates[1:]] == [u.last for u in updates[:-1]]
    assert not any(u.new_segment for u in updates[1:])


def test_every_segment_begins_anew_and_no_update_lies_between():
    stamps = np.arange(4001) * STEP
    keep = np.r_[0:1601, 2000:4001]  # one second is missing after 4 s
    tau = np.arange(0.0, 10.0, 0.012)
    readings = readings_of(stamps[keep], ((0, 1600), (1601, keep.size - 1)))
    updates = schedule_updates(readings, tau, poses_at(tau), (), 0.24)
    times = np.array([u.tau for u in updates])
    assert not np.any((times >= 4.0) & (times <= 5.0))
    begins = [k for k, u in enumerate(updates) if u.new_segment]
    assert [times[k] > 5.0 for k in begins] == [False, True]
    assert all(updates[k].first == updates[k].last for k in begins)
    assert 1601 < updates[begins[1]].last < 1601 + 0.012 / STEP + 2  # not the very first sample of the segment


def test_missing_poses_are_waited_for():
    tau = np.arange(0.0, 9.0, 0.012)
    kept = tau[(tau < 3.0) | (tau > 5.0)]
    updates = schedule_updates(even_readings(), 0.5 + kept, poses_at(kept), (), 0.24)
    assert len({u.pose for u in updates}) == len(updates)
    times = np.array([u.tau for u in updates])
    grid = np.round(times / 0.24) * 0.24
    assert np.abs(times - grid).max() < 0.012  # the grid is kept beyond the hole
    assert np.diff(times).max() > 2.0
    np.testing.assert_allclose(np.sort(np.diff(times))[:-1], 0.24, atol=0.012)


def test_an_interval_shorter_than_that_of_the_poses_uses_each_once():
    tau = np.arange(0.0, 9.0, 0.012)
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau), (), 0.005)
    assert [u.pose for u in updates] == list(range(tau.size))


def test_poses_faster_than_samples_use_no_sample_twice():
    tau = np.arange(0.0, 2.0, 0.001)
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau), (), 0.001)
    samples = np.array([u.last for u in updates])
    assert np.all(np.diff(samples) == 1)
    np.testing.assert_allclose(STEP * samples, [0.5 + u.tau for u in updates], atol=0.5 * STEP + 1e-9)


def test_updates_know_their_standstill_and_which_is_its_first():
    tau = np.arange(0.0, 9.0, 0.012)
    standstills = (Standstill(0.4, 1.5), Standstill(4.0, 4.1), Standstill(6.0, 9.4))
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau), standstills, 0.24)
    for u in updates:
        t = 0.5 + u.tau
        expected = [k for k, s in enumerate(standstills) if s.start <= t <= s.stop]
        assert u.standstill == (expected[0] if expected else None)
    seen = [u.standstill for u in updates]
    firsts = [k for k, u in enumerate(updates) if u.new_standstill]
    assert [seen[k] for k in firsts] == sorted({s for s in seen if s is not None})
    assert firsts == [seen.index(seen[k]) for k in firsts]
    assert 0 in seen
    assert 2 in seen


def test_a_standstill_a_gap_of_the_readings_lies_in_is_one_standstill():
    stamps = np.arange(4001) * STEP
    keep = np.r_[0:1601, 1640:4001]
    tau = np.arange(0.0, 10.0, 0.012)
    segments = ((0, 1600), (1601, keep.size - 1))
    updates = schedule_updates(readings_of(stamps[keep], segments), tau, poses_at(tau), (Standstill(3.0, 5.0),), 0.24)
    assert sum(u.new_standstill for u in updates) == 1
    assert sum(u.new_segment for u in updates) == 2


def test_without_poses_in_common_there_are_no_updates():
    tau = np.arange(0.0, 9.0, 0.012)
    assert schedule_updates(even_readings(), tau - 100.0, poses_at(tau), (), 0.48) == ()
    assert schedule_updates(even_readings(), tau + 9.99, poses_at(tau), (), 0.48) == ()  # a single pose


def test_doubtful_poses_are_not_used():
    tau = np.arange(0.0, 9.0, 0.012)
    doubtful = (tau > 3.0) & (tau < 5.0)
    updates = schedule_updates(even_readings(), 0.5 + tau, poses_at(tau, doubtful), (), 0.24)
    assert not any(3.0 < u.tau < 5.0 for u in updates)
    assert sum(u.tau > 5.0 for u in updates) > 10

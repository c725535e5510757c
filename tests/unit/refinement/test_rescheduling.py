"""The problem of a further pass: by other clocks, and with attitudes that the reference did not show."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from kreisel.model.problem import with_readings
from kreisel.refinement.rescheduling import assigns_otherwise, rescheduled, with_attitudes_of
from kreisel.synchronization.clock import Clock

from ...small_problem import RATE, plain_run, small_problem

STEP = 1.0 / RATE


def without_orientations():
    problem = small_problem()
    return replace(problem, reference=replace(problem.reference, quaternions=None))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_half_a_sample_decides_whether_poses_belong_to_others(sign):
    problem = small_problem()
    clock = problem.schedule.clock
    assert not assigns_otherwise(problem, replace(clock, start=clock.start + sign * 0.49 * STEP))
    assert assigns_otherwise(problem, replace(clock, start=clock.start + sign * 0.51 * STEP))


def test_a_ratio_of_the_clocks_counts_where_it_has_gathered_most():
    problem = small_problem()
    clock, seconds = problem.schedule.clock, problem.reference.seconds[-1]
    for share, otherwise in ((0.49, False), (0.51, True)):
        skewed = replace(clock, skew=clock.skew + share * STEP / seconds)
        assert assigns_otherwise(problem, skewed) is otherwise


def test_clocks_that_agree_leave_the_problem_as_it_is():
    problem = small_problem()
    clock = problem.schedule.clock
    assert rescheduled(problem, replace(clock, start=clock.start + 0.3 * STEP)) is problem


@pytest.mark.parametrize("shift", [-0.031, 0.052])
def test_by_another_clock_each_pose_is_used_at_the_sample_nearest_to_it(shift):
    problem = small_problem()
    clock = replace(problem.schedule.clock, start=problem.schedule.clock.start + shift)
    found = rescheduled(problem, clock)
    t = problem.sensor.readings.stamps
    assert found.schedule.clock == clock
    for update in found.schedule.updates:
        at = clock.start + (1.0 + clock.skew) * problem.reference.seconds[update.pose]
        assert abs(t[update.last] - at) == np.min(np.abs(t - at))
    assert len(found.schedule.attitude) == len(found.schedule.updates)
    assert found.schedule.interval == problem.schedule.interval


def test_standstills_are_found_again_unless_they_are_given():
    """Nothing moves in the overlap of two standstills: shifted by 0.6 s, it is shorter."""
    problem = small_problem()
    clock = replace(problem.schedule.clock, start=problem.schedule.clock.start + 0.6)
    total = sum(s.stop - s.start for s in problem.schedule.standstills)
    again = rescheduled(problem, clock).schedule
    assert sum(s.stop - s.start for s in again.standstills) < 0.8 * total
    given = replace(problem, schedule=replace(problem.schedule, stillness=None))
    assert rescheduled(given, clock).schedule.standstills == problem.schedule.standstills


def test_the_scatter_of_poses_is_that_within_the_standstills_found_again():
    problem = small_problem()
    rng = np.random.default_rng(5)
    shaken = problem.reference.positions + 4e-4 * rng.standard_normal(problem.reference.positions.shape)
    problem = replace(problem, reference=replace(problem.reference, positions=shaken))
    assert problem.noise.reference.jitter_position < 1e-4
    clock = replace(problem.schedule.clock, start=problem.schedule.clock.start + 0.1)
    again = rescheduled(problem, clock)
    assert again.schedule.standstills
    assert again.noise.reference.jitter_position == pytest.approx(4e-4, rel=0.3)


def test_a_clock_that_leaves_too_few_updates_is_not_followed():
    problem = small_problem()
    assert rescheduled(problem, Clock(problem.sensor.readings.stamps[-1] - 3.0)) is problem


def test_without_orientations_updates_stay_where_they_are():
    problem = without_orientations()
    assert rescheduled(problem, Clock(1.0)) is problem


def test_attitudes_integrated_back_are_those_the_reference_had():
    """From a run that saw the orientations, which are then taken away.

    Its gyros' noise, 4.4e-5 rad/sqrt(s), gathers 0.3 mrad in 40 s, and their scale is known to some 0.1 mrad in the
    12 rad turned; the poses' own errors of 0.5 mrad come on top: together less than 2 mrad.
    """
    run, problem = plain_run(), without_orientations()
    found = with_attitudes_of(problem, run).schedule
    whole = small_problem().reference
    at = run.parameters.clock.reference_time(problem.sensor.readings.stamps[[u.last for u in found.updates]])
    inside = (at > whole.seconds[0]) & (at < whole.seconds[-1])
    truth = Slerp(whole.seconds, Rotation.from_quat(whole.quaternions, scalar_first=True))(at[inside])
    off = truth.inv() * Rotation.from_quat(found.attitude[inside], scalar_first=True)
    assert inside.sum() > 70
    assert off.magnitude().max() < 3e-3
    assert found.attitude_sd == 0.01


def test_the_earths_rotation_is_taken_off():
    """Left in, it would turn attitudes by 7.3e-5 rad/s: a hundred times its rate makes that plain."""
    run, problem = plain_run(), without_orientations()
    fast = replace(problem, site=replace(problem.site, earth_rate_n=101.0 * problem.site.earth_rate_n))
    as_it_is, turned = (with_attitudes_of(p, run).schedule.attitude for p in (problem, fast))
    off = Rotation.from_quat(turned, scalar_first=True) * Rotation.from_quat(as_it_is, scalar_first=True).inv()
    p = run.parameters
    level, down = problem.site.earth_rate_units
    earth = Rotation.from_quat(p.q_rn, scalar_first=True).apply([*(level * p.north), down])
    seconds = problem.sensor.readings.stamps[[u.last for u in problem.schedule.updates]]
    want = -(seconds - seconds[-1])[:, None] * 100.0 * earth
    np.testing.assert_allclose(off.as_rotvec(), want, atol=2e-7)


def test_nothing_is_carried_over_a_gap_or_where_the_reference_shows_attitudes():
    run, problem = plain_run(), without_orientations()
    n = problem.sensor.readings.stamps.size
    gap = with_readings(problem, replace(problem.sensor.readings, segments=((0, 1500), (1510, n - 1))))
    assert with_attitudes_of(gap, run) is gap
    assert with_attitudes_of(small_problem(), run) is small_problem()

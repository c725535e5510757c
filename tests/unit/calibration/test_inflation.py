"""What is added for errors that are not estimated: covariances, a symmetry of mechanics, and what gravity costs."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.data_sheet import sensitivity
from kreisel.calibration.evidence import LatitudeCheck
from kreisel.calibration.frame_errors import frame_columns
from kreisel.calibration.inflation import (
    frame_deviations,
    with_doubtful_latitude,
    with_open_periods,
    with_unestimated_errors,
    with_walked_deviations,
)
from kreisel.calibration.linear_errors import linear_columns
from kreisel.kalman.batch import path_near
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.problem import walked_variance, with_readings

from ...oracle import quaternions as quat
from ...small_problem import camera_problem, estimate_of, small_problem, small_run, with_noise


def without(problem):
    moving = replace(problem, schedule=replace(problem.schedule, standstills=()))
    return with_noise(moving, frame_sd=(0.0, 0.0), lateness=0.0, time_base_sd=0.0)


def test_without_such_errors_the_belief_stays_as_it_is():
    found = estimate_of(without(small_problem()), small_run())
    assert with_unestimated_errors(found).belief is found.run.belief


def test_lateness_adds_its_square_to_the_clocks_and_to_nothing_else():
    found = estimate_of(with_noise(without(small_problem()), lateness=3e-4), small_run())
    added = with_unestimated_errors(found).belief.covariance - found.run.belief.covariance
    layout, seconds = found.problem.layout, np.ptp(found.run.history.seconds)
    want = np.zeros_like(added)
    for group, size in (("time_offset", 3e-4), ("time_skew", 3e-4 / seconds)):
        want[layout[group], layout[group]] = size**2
    sd = found.run.belief.standard_deviation
    np.testing.assert_allclose(added / np.outer(sd, sd), want / np.outer(sd, sd), atol=1e-9)


def test_frames_and_linear_errors_add_the_squares_of_their_columns():
    problem = with_noise(small_problem(), frame_sd=(2e-3, 1e-3), time_base_sd=0.0)
    found = estimate_of(problem, small_run())
    after = with_unestimated_errors(found)
    linear = linear_columns(problem, KalmanFilter().linearise(problem, small_run()), (2e-3, 1e-3))
    columns = np.hstack([frame_columns(problem, found.run.parameters), *linear])
    added = after.belief.covariance - found.run.belief.covariance
    sd = after.deviation
    np.testing.assert_allclose(added / np.outer(sd, sd), columns @ columns.T / np.outer(sd, sd), atol=1e-9)
    assert [w.subject for w in after.warnings][:1] == ["robot"]
    assert "2 mm and 1 mrad" in after.warnings[0].message


def changing(path, density):
    """An estimate of offsets of the gyros that follow a path (n, 3), taken for a walk of a density."""
    problem = with_noise(camera_problem(), offset_walk={"gyro_offset": density})
    readings = problem.sensor.readings
    problem = with_readings(problem, readings.with_values(rates=readings.rates - path(readings.stamps)))
    run = KalmanFilter().refit(problem, KalmanFilter().fit(problem))
    return replace(estimate_of(problem, run), walks={"gyro_offset": 10.0})


def added_by_walks(found):
    columns = with_walked_deviations(found, path_near).contributions[-1].columns
    return np.sqrt(np.sum(columns[found.problem.layout["gyro_offset"]] ** 2, axis=1))


def test_what_walks_is_as_uncertain_as_it_walked():
    rng, density = np.random.default_rng(7), 2e-3
    seconds = camera_problem().sensor.readings.stamps
    steps = rng.normal(size=(seconds.size, 3)) * density * np.sqrt(np.gradient(seconds))[:, None]
    walk = np.cumsum(steps, axis=0)
    far = np.sqrt(np.mean((walk - walk[-1]) ** 2, axis=0))
    np.testing.assert_allclose(added_by_walks(changing(lambda _: walk, density)), far, rtol=0.25)


def test_what_comes_and_goes_is_no_more_uncertain_than_it_is_large():
    """A walk of the density that follows it would lead far away."""

    def swinging(t):
        return np.outer(2e-3 * np.sin(2.0 * np.pi * t / 8.0), np.ones(3))

    found = changing(swinging, 2e-3)
    added = added_by_walks(found)
    assert (added > 1e-3).all()
    assert (added < 4e-3).all()
    assert walked_variance(found.problem, "gyro_offset") ** 0.5 > 10e-3


def test_frames_err_as_the_poses_are_found_to():
    """Beyond what was assumed at first, on the path or at standstill, whichever is more; not less than assumed."""
    first = with_noise(small_problem(), frame_sd=(2e-3, 1e-3))
    assumed = first.noise.reference
    assert frame_deviations(estimate_of(first, small_run())) == (2e-3, 1e-3)
    larger = replace(assumed, position=1e-3, standstill_position=5e-3, orientation=3e-3)
    found = replace(estimate_of(with_noise(first, reference=larger), small_run()), stated=first)
    length, angle = frame_deviations(found)
    assert length == pytest.approx(np.sqrt(5e-3**2 - assumed.standstill_position**2))
    assert angle == pytest.approx(np.sqrt(3e-3**2 - assumed.orientation**2))


@pytest.mark.parametrize(("frame_sd", "shown"), [((0.0, 1e-3), False), ((2e-3, 1e-3), False), ((1e-3, 1e-3), True)])
def test_a_size_that_is_not_the_stated_one_is_what_poses_show(frame_sd, shown):
    """Lengths may be stated to be exact."""
    stated = with_noise(small_problem(), frame_sd=(2e-3 if frame_sd[0] else 0.0, 1e-3))
    found = estimate_of(with_noise(stated, frame_sd=frame_sd), small_run())
    (warning,) = (w for w in with_unestimated_errors(replace(found, stated=stated)).warnings if w.subject == "robot")
    assert ("as large as the poses show" in warning.message) == shown


def limited_by_gravity(share):
    """A belief in which gravity causes all but a share of the variance of the accelerometers' mean scale."""
    problem, run = without(small_problem()), small_run()
    layout, factor = problem.layout, run.belief.factor.copy()
    K_a = run.parameters.sensors.K_a
    d, g = layout["accel_cross_coupling"], layout["gravity"].start
    factor[d], factor[g] = 0.0, 0.0
    own, common = 1e-4 * share**0.5, 1e-4 * (1.0 - share) ** 0.5
    factor[d, d.start] = own * K_a.ravel()  # all scale factors alike
    factor[d, g] = common * K_a.ravel()
    factor[g, g] = 9.81e-4
    return estimate_of(problem, replace(run, belief=replace(run.belief, factor=factor)))


def test_what_gravity_costs_the_scale_factors_is_told_in_ppm():
    """The mean scale factor, one over K_a, is then known to 100 ppm, and to 100 ppm times the root of the share."""
    found = limited_by_gravity(0.04)
    (warning,) = with_unestimated_errors(found).warnings
    assert warning.subject == "site"
    limited, known = (float(x) for x in re.search(r"(\d+) ppm instead of (\d+) ppm", warning.message).groups())
    assert (limited, known) == (100.0, 20.0)


def test_the_mean_scale_factor_is_that_of_the_data_sheet():
    """Changes of the scale factors by finite differences, carried through the covariance of a real run."""
    run, problem = small_run(), without(small_problem())
    mount = quat.matrix(quat.exp(np.array([0.5, -0.4, 0.9])))
    K = mount @ run.parameters.sensors.K_a
    run = replace(run, parameters=replace(run.parameters, sensors=replace(run.parameters.sensors, K_a=K)))
    d, g = problem.layout["accel_cross_coupling"], problem.layout["gravity"].start
    J = np.empty(9)
    for i in range(9):
        h = 1e-6 * np.eye(9)[i].reshape(3, 3)
        scales = [np.log(sensitivity(K + sign * h)[0]).mean() for sign in (1.0, -1.0)]
        J[i] = (scales[0] - scales[1]) / 2e-6
    wide = run.belief.covariance + 1e-6 * np.outer(*2 * [column_of_gravity(problem, K)])
    belief = replace(run.belief, factor=np.linalg.cholesky(wide))
    (warning,) = with_unestimated_errors(estimate_of(problem, replace(run, belief=belief))).warnings
    limited, known = (float(x) for x in re.search(r"(\d+) ppm instead of (\d+) ppm", warning.message).groups())
    P = wide[d, d]
    conditional = P - np.outer(wide[d, g], wide[d, g]) / wide[g, g]
    # the axes are square within 1 %, and the mean of three logarithms is as good as their determinant's
    assert limited == pytest.approx(1e6 * (J @ P @ J) ** 0.5, rel=0.02)
    assert known == pytest.approx(1e6 * (J @ conditional @ J) ** 0.5, rel=0.02, abs=1.0)


def column_of_gravity(problem, K):
    """What an error of gravity does: K_a grows with it."""
    column = np.zeros(problem.layout.degrees)
    column[problem.layout["accel_cross_coupling"]] = K.ravel()
    column[problem.layout["gravity"]] = 9.81
    return column


def test_gravity_that_costs_little_or_is_no_parameter_is_not_mentioned():
    assert with_unestimated_errors(limited_by_gravity(0.26)).warnings == ()
    assert len(with_unestimated_errors(limited_by_gravity(0.24)).warnings) == 1


@pytest.mark.parametrize(("score", "share"), [(2.4, 0.0), (3.5, 0.604), (6.0, 1.0)])
def test_a_doubtful_latitude_counts_by_its_probability(score, share):
    """Gravity of 50 deg instead of 40 deg: 9.8107 and 9.8017 m/s^2 by the tables of WGS 84. exp(3.5^2 / 2) = 457."""
    found = limited_by_gravity(0.3)
    checked = with_doubtful_latitude(found, LatitudeCheck(40.0, 50.0, 3.0, score))
    problem = found.problem
    i = problem.layout["gravity"].start
    before, after = (one.belief.covariance for one in (found, checked))
    assert after[i, i] - before[i, i] == pytest.approx(share * 0.0090**2, rel=0.02, abs=1e-12)
    slope = before[:, i] / before[i, i]
    np.testing.assert_allclose(after - before, (after - before)[i, i] * np.outer(slope, slope), atol=1e-9)
    assert len(checked.warnings) == len(found.warnings) + (score > 2.5)
    assert with_doubtful_latitude(found, None) is found


def test_periods_of_a_repeated_motion_add_the_largest_to_the_time_offset_alone():
    found = estimate_of(small_problem(), small_run())
    i = found.problem.layout["time_offset"].start
    added = with_open_periods(found, (10.0, -20.0)).belief.covariance - found.belief.covariance
    assert added[i, i] == pytest.approx(400.0)
    added[i, i] = 0.0
    assert np.abs(added).max() < 1e-12
    assert with_open_periods(found, ()) is found

"""Passes over a problem: when they end, what they find of the noise, and what correlated innovations cost."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from kreisel.estimation.belief import Belief
from kreisel.fitting.fit import Fit
from kreisel.kalman.kalman_filter import KalmanFilter
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.problem import with_correlation_time
from kreisel.refinement import settling
from kreisel.refinement.iteration import _contradiction, correlation_factor, estimate
from kreisel.refinement.noise_adaptation import NoiseFactors, StatedFigures, imu_density, with_factors
from kreisel.refinement.settling import (
    MAX_PASSES,
    NEAR,
    SETTLED,
    another_pass,
    change_of,
    relaxation,
    wide_gate_mattered,
)
from kreisel.synchronization.clock import Clock

from ...small_problem import camera_problem, history, recorded, with_noise

SPKF = KalmanFilter()
SPKF = KalmanFilter()
BOTH = StatedFigures(reference=True, imu=True)
IMU_ONLY = StatedFigures(reference=False, imu=True)


@cache
def usual():
    return estimate(camera_problem(), BOTH, SPKF)


def with_reference(problem, **changed):
    return with_noise(problem, reference=replace(problem.noise.reference, **changed))


@cache
def drifting(time=1.0, size=1e-3):
    """The problem of a reference whose positions err for about a second, by more than its noise."""
    problem = camera_problem()
    rng, reference = np.random.default_rng(0), problem.reference
    keep = np.exp(-reference.interval / time)
    error = size * rng.normal(size=reference.positions.shape)
    for i in range(1, len(error)):
        error[i] = keep * error[i - 1] + (1.0 - keep**2) ** 0.5 * error[i]
    return replace(problem, reference=replace(reference, positions=reference.positions + error))


def run_of(made, **changed):
    return Fit(None, None, None, made, **changed)


def autoregressive(rng, phi, count, scale=1.0):
    x = rng.normal(size=(count, 9))
    for i in range(1, count):
        x[i] = phi * x[i - 1] + (1.0 - phi**2) ** 0.5 * x[i]
    return scale * x


@pytest.mark.parametrize("phi", [0.6, 0.8])
def test_correlated_innovations_count_as_often_as_they_are_independent(phi):
    """The mean of an autoregressive series is as uncertain as that of one in (1 + phi) / (1 - phi) of its values.

    Sokal: the time found has the relative variance 2 (2 M + 1) / n, with M = 6 times; n = 3 * 8000 here: 9.5 % of a
    time of 9, half of that in the root; 2.5 deviations are allowed, since the larger of two is taken.
    """
    whitened = autoregressive(np.random.default_rng(0), phi, 8000)
    nis = np.full(8000, 6.0)
    found = correlation_factor(run_of(history(8000, whitened=whitened, nis=nis)))
    assert found == pytest.approx(((1.0 + phi) / (1.0 - phi)) ** 0.5, rel=0.12)


def test_white_and_hardly_correlated_innovations_cost_nothing():
    rng = np.random.default_rng(1)
    for phi in (0.0, 0.25):
        made = history(5000, whitened=autoregressive(rng, phi, 5000), nis=np.full(5000, 6.0))
        assert correlation_factor(run_of(made)) == 1.0


def test_innovations_smaller_than_assumed_leave_room_for_their_correlation():
    whitened = autoregressive(np.random.default_rng(2), 0.8, 5000)
    whole, half = (
        correlation_factor(run_of(history(5000, whitened=whitened, nis=np.full(5000, nis)))) for nis in (6.0, 3.0)
    )
    assert half**2 == pytest.approx(0.5 * whole**2, rel=1e-12)
    larger = correlation_factor(run_of(history(5000, whitened=whitened, nis=np.full(5000, 60.0))))
    assert larger == whole
    tiny = history(5000, whitened=whitened, nis=np.full(5000, 0.1))
    assert correlation_factor(run_of(tiny)) == 1.0
    fitted = run_of(history(5000, whitened=whitened, nis=np.full(5000, 3.0)), fitted=0.5 * 30000.0)
    assert correlation_factor(fitted) == pytest.approx(whole)


def test_position_or_orientation_whichever_is_correlated_longer_counts_and_standstills_do_not():
    rng = np.random.default_rng(3)
    whitened, nis = rng.normal(size=(5000, 9)), np.full(5000, 6.0)
    slow = autoregressive(rng, 0.9, 5000)
    for rows in (slice(0, 3), slice(3, 6)):
        mixed = whitened.copy()
        mixed[:, rows] = slow[:, rows]
        assert correlation_factor(run_of(history(5000, whitened=mixed, nis=nis))) > 3.0
        blind = mixed.copy()
        blind[:, 3 - rows.start : 6 - rows.start] = np.nan  # the other is not measured
        assert correlation_factor(run_of(history(5000, whitened=blind, nis=nis))) > 3.0
    still = history(5000, whitened=slow, nis=nis, at_standstill=np.ones(5000, dtype=bool))
    assert correlation_factor(run_of(still)) == 1.0
    rejected = history(5000, whitened=slow, nis=nis, used=np.zeros(5000, dtype=bool))
    assert correlation_factor(run_of(rejected)) == 1.0
    assert correlation_factor(run_of(history(19, whitened=slow[:19], nis=nis[:19]))) == 1.0


@pytest.mark.parametrize("degrees", [6, 9])
def test_a_wide_gate_mattered_if_it_let_through_something_gross_or_much(degrees):
    bound = chi2.isf(1e-6, degrees)

    def mattered(nis, used=True):
        made = history(1000, nis=np.resize(nis, 1000), degrees=np.full(1000, float(degrees)))
        return wide_gate_mattered(run_of(replace(made, used=np.full(1000, used))))

    few, gross, many = np.full(1000, 5.0), np.full(1000, 5.0), np.full(1000, 5.0)
    few[:2], gross[0], many[:3] = 3.9 * bound, 4.1 * bound, 1.1 * bound
    assert not mattered(few)
    assert mattered(gross)
    assert mattered(many)
    assert not mattered(gross, used=False)  # that was rejected all the same


def test_the_change_by_a_pass_is_in_deviations():
    problem = camera_problem()
    n = len(problem.parameter_names)
    run = usual().run
    sd = run.belief.standard_deviation
    for i in (0, problem.layout["alignment"].start, n - 1):
        change = np.zeros(problem.layout.degrees)
        change[i], change[n:] = -1.7 * sd[i], 9.0  # navigation does not count
        before = Belief(problem.layout.plus(run.belief.mean, change[:, None])[:, 0], 5.0 * run.belief.factor)
        change = change_of(problem, replace(run, belief=before), run)
        assert np.abs(change).max() == pytest.approx(1.7, rel=1e-3)
        assert np.sum(np.abs(change) > 1e-6) == 1


def test_a_right_start_and_right_noise_need_one_pass():
    found = usual()
    # the second looks for further effects
    assert (found.passes, found.moved, found.contradiction, found.correlation_factor) == (2, 0.0, 1.0, 1.0)
    assert found.warnings == ()
    assert found.problem is camera_problem()


def test_errors_of_the_estimate_are_as_large_as_its_covariance_says():
    """Squared, and normalised by the covariance, the errors of 33 sensor parameters are a chi-square variable."""
    problem, run, sensors = usual().problem, usual().run, recorded()[0].sensors
    m = problem.sensor_degrees
    truth = [sensors.K_omega.ravel(), sensors.k_w[0], sensors.K_a.ravel(), sensors.k_a[0], sensors.lever_arms.ravel()]
    error = run.belief.mean[:m] - np.concatenate(truth)
    sd = run.belief.standard_deviation[:m]
    P = run.belief.covariance[:m, :m] / np.outer(sd, sd)
    nees = (error / sd) @ np.linalg.solve(P, error / sd)
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], m)
    assert low < nees < high


@pytest.mark.parametrize("passes", [1, 2, 4])
def test_as_many_passes_are_run_as_asked_for(passes):
    problem = replace(camera_problem(), settings=CalibrationSettings(passes=passes))
    found = estimate(problem, BOTH, SPKF)
    assert found.passes == passes
    assert (found.moved == 0.0) == (passes == 1)
    assert found.moved < SETTLED


def test_noise_that_is_not_given_is_found():
    """Ten times too large at first. What is found is within a third of what was simulated: 0.5 mm and 0.5 mrad."""
    found = estimate(with_reference(camera_problem(), position=5e-3, orientation=5e-3), IMU_ONLY, SPKF)
    noise = found.problem.noise.reference
    assert 0.5e-3 / 1.33 < noise.position < 0.5e-3 * 1.33
    assert 0.5e-3 / 1.33 < noise.orientation < 0.5e-3 * 1.33
    assert [w.subject for w in found.warnings] == ["noise"]
    assert found.contradiction == 1.0


def test_given_noise_that_is_too_large_is_kept():
    problem = with_reference(camera_problem(), position=5e-3, orientation=5e-3)
    found = estimate(problem, BOTH, SPKF)
    assert found.problem.noise.reference == problem.noise.reference
    assert found.warnings == ()


def test_given_noise_that_is_far_too_small_is_replaced_and_that_is_said():
    problem = with_reference(camera_problem(), position=1e-4, orientation=1e-4)
    found = estimate(problem, BOTH, SPKF)
    after = found.problem.noise.reference
    ratios = [after.position / 1e-4, after.orientation / 1e-4]
    ratios += list(np.array(imu_density(found.problem)) / imu_density(problem))
    assert found.contradiction == pytest.approx(max(ratios), rel=1e-12)
    assert found.contradiction > 3.0
    assert "given noise figures contradict the data" in found.warnings[0].message


def test_noise_that_grows_from_pass_to_pass_is_given_up_for_the_likeliest(monkeypatch):
    """Eight passes that ask for 1.4 times as much would end at ten times the gyros' noise, which is right at first."""
    problem = with_noise(camera_problem(), imu_bounds=((0.0, 1.0), (0.0, 1.0)))
    monkeypatch.setattr(settling, "noise_factors", lambda *_: NoiseFactors(gyro=1.4))
    found = estimate(problem, StatedFigures(reference=True, imu=False), SPKF)
    assert imu_density(found.problem)[0] < 2.0 * imu_density(problem)[0]
    assert found.moved < SETTLED


def test_figures_too_small_show_as_soon_as_estimates_stand_still():
    """Stated twice too small: a wide gate rejects nothing, the usual one would reject 8 % of the poses."""
    rejected = []

    class Watched(KalmanFilter):
        def refit(self, *of, **how):
            run = super().refit(*of, **how)
            rejected.append(1.0 - float(np.mean(run.history.used)))
            return run

    problem = with_reference(camera_problem(), position=2.2e-4, orientation=2.2e-4)
    found = estimate(started_late(problem), BOTH, Watched())
    assert found.problem.noise.reference.position > 3.5e-4
    assert max(rejected) < 0.02


def test_contradiction_counts_only_figures_that_were_given():
    before = camera_problem()
    after = with_factors(before, NoiseFactors(position=3.0, orientation=4.0, gyro=5.0, accel=2.0))
    assert _contradiction(before, after, BOTH) == pytest.approx(5.0)
    assert _contradiction(before, after, StatedFigures(reference=True, imu=False)) == pytest.approx(4.0)
    assert _contradiction(before, after, StatedFigures(reference=False, imu=False)) == 1.0
    smaller = with_factors(before, NoiseFactors(0.1, 0.1, 0.1, 0.1, 0.1))
    assert _contradiction(before, smaller, BOTH) == 1.0


def test_a_group_the_motion_does_not_show_keeps_its_prior():
    """What is not observable stays as uncertain as it was, and makes what depends on it uncertain too."""
    problem = camera_problem()
    d, covariance = problem.layout["lever_arms"], 1e-10 * np.eye(9)
    narrow = replace(problem.prior, covariance=problem.prior.covariance | {"lever_arms": covariance})
    found = estimate(replace(problem, prior=narrow), BOTH, SPKF)
    sd = found.run.belief.standard_deviation[d]
    np.testing.assert_allclose(sd, 1e-5, rtol=0.05)


def test_with_passes_stated_correlated_innovations_widen_the_result():
    problem = with_reference(
        drifting(), position=1e-3, standstill_position=1e-3, jitter_position=2e-4, velocity=2e-3
    )  # so that no figure is contradicted, and one pass is all
    problem = replace(problem, settings=CalibrationSettings(passes=1))
    plain, found = KalmanFilter().fit(problem, gate=100.0), estimate(problem, BOTH, SPKF)
    factor = correlation_factor(plain)
    assert found.passes == 1
    assert found.correlation_factor == factor > 1.0
    np.testing.assert_array_equal(found.run.belief.factor, plain.belief.factor)
    np.testing.assert_allclose(found.deviation, factor * plain.belief.standard_deviation, rtol=1e-12)
    np.testing.assert_array_equal(found.run.belief.mean, plain.belief.mean)
    assert f"multiplied by {factor:.2f}" in found.warnings[-1].message


def test_coloured_noise_is_assumed_where_its_likelihood_is_higher():
    found = estimate(drifting(), IMU_ONLY, SPKF)
    time = found.problem.noise.correlation_time
    assert time > 0.0
    coloured = float(KalmanFilter().refit(found.problem, found.run).history.log_likelihood.sum())
    path_errors = ("path_position", "path_orientation")
    kept = [part for part in found.problem.layout if part.name not in path_errors]
    assert all(name in found.problem.layout for name in path_errors)
    white = replace(found.problem, layout=type(found.problem.layout)(kept))
    white = with_noise(white, correlation_time=0.0)
    run = replace(found.run, belief=KalmanFilter().fit(white).belief)
    assert coloured > float(KalmanFilter().refit(white, run).history.log_likelihood.sum()) + 5.0
    assert f"{time:.2g} s" in found.warnings[-1].message


def test_white_noise_is_not_taken_for_coloured():
    assert usual().problem.noise.correlation_time == 0.0
    assert usual().problem.layout.degrees == camera_problem().layout.degrees
    assert with_correlation_time(camera_problem(), 1.0).layout.degrees == camera_problem().layout.degrees + 6


def test_another_pass_is_run_where_it_pays():
    problem, run = camera_problem(), usual().run
    assert not another_pass(problem, run, np.inf, 1)
    assert another_pass(problem, run, SETTLED + 0.01, 2)
    assert not another_pass(problem, run, SETTLED - 0.01, 2)
    assert not another_pass(problem, run, NEAR, MAX_PASSES)  # enough
    cubic = replace(problem, settings=CalibrationSettings(polynomial_order=3))
    assert another_pass(cubic, run, 0.0, 1)
    blind = replace(problem, reference=replace(problem.reference, quaternions=None))
    assert another_pass(blind, run, 0.0, 1)
    late = replace(run, parameters=replace(run.parameters, start=run.parameters.start + 0.02))
    assert another_pass(problem, late, 0.0, 1)
    assert late.parameters.clock == Clock(run.parameters.start + 0.02, run.parameters.skew)
    far = replace(run, start=replace(run.start, sensors=replace(run.start.sensors, K_a=run.start.sensors.K_a + 0.1)))
    assert another_pass(problem, far, 0.0, 1)
    gross = run.history.nis.copy()
    gross[20] = 1e4
    let_through = replace(run, history=replace(run.history, nis=gross, used=np.ones(gross.size, dtype=bool)))
    assert another_pass(problem, let_through, 0.0, 1)


def started_late(problem):
    """Twenty milliseconds, which are two samples."""
    start = problem.prior.start
    off = replace(start, start=start.start + 0.02)
    clock = replace(problem.schedule.clock, start=off.start)
    wide = problem.prior.start_covariance | {"time_offset": np.array([[0.03**2]])}
    return replace(problem, schedule=replace(problem.schedule, clock=clock),
                   prior=replace(problem.prior, start=off, start_covariance=wide))  # fmt: skip


def test_a_pass_from_a_start_far_off_is_repeated_until_it_settles():
    """The answer is that of a right start."""
    problem = camera_problem()
    found = estimate(started_late(problem), BOTH, SPKF)
    assert found.passes > 1
    assert found.moved < SETTLED
    assert np.abs(change_of(problem, found.run, usual().run)).max() < SETTLED


@pytest.mark.parametrize("answer", [-0.9, -3.0, 0.5])
def test_passes_that_answer_by_the_opposite_come_to_rest(answer):
    """A pass leads from x to `answer` times x, about a point of rest."""
    rest, x, share, before = np.array([2.0, -1.0]), np.array([5.0, 5.0]), 1.0, np.zeros(0)
    for _ in range(12):
        change = rest + answer * (x - rest) - x
        share, before = relaxation(share, before, change), change
        x = x + share * change
    assert np.abs(x - rest).max() < 1e-2

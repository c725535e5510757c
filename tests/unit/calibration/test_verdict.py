"""The verdict: each reason on either side of its bound, and none without cause."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from kreisel.calibration.evidence import Evidence, LatitudeCheck, SplitHalves
from kreisel.calibration.result_sections import Cause, Consistency
from kreisel.calibration.verdict import (
    MAX_CONTRADICTION,
    MAX_MOVED,
    MAX_NIS,
    MAX_SCORE,
    MAX_UNLISTED,
    Reason,
    consistency,
    judge,
    verdict_by,
)
from kreisel.estimation.uncertainty import Contribution, each
from kreisel.estimation.uncertainty_budget import Source
from kreisel.fitting.terms import GYRO_ROWS
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.model.groups import group_named
from kreisel.model.parameters import walk_of
from kreisel.refinement.discrepancy_terms import Family, FoundFamily
from kreisel.refinement.observability import Observability
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.fits import Correlation
from kreisel.units import DEG

from ...small_problem import estimate_of, history, moved_by, small_problem, small_run

FACTS = Consistency(1.0, 1.0, 100, 0, np.zeros(6), 1.0, 0.99)
SEEN = Observability((), np.zeros(0), np.zeros(0), (), ())


def found(**changed):
    return estimate_of(**({"problem": small_problem(), "run": small_run()} | changed))


def reasons(estimate=None, *, facts=FACTS, seen=SEEN, halves=None, latitude=None):
    verdict = judge(estimate or found(), Evidence(seen, facts, halves, latitude))
    assert verdict.accepted == (not verdict.reasons)
    assert verdict.unobservable == seen.unobservable
    return verdict.reasons


def test_a_sound_result_is_accepted():
    assert reasons() == ()


@pytest.mark.parametrize(("field", "where"), [("nis_path", "on the path"), ("nis_standstill", "at standstill")])
def test_innovations_too_large_are_named_with_their_size(field, where):
    assert reasons(facts=replace(FACTS, **{field: 0.99 * MAX_NIS})) == ()
    (reason,) = reasons(facts=replace(FACTS, **{field: 9.0}))
    assert len(reasons(facts=replace(FACTS, **{field: 1.01 * MAX_NIS}))) == 1
    assert f"innovations {where} are 3.0 times" in reason


def test_errors_on_no_list_that_no_device_has_are_a_reason():
    def of(size):
        family = Family("gyroscope", "time", tuple(GYRO_ROWS))
        return found(discrepancy=(FoundFamily(family, 100.0, size),))

    usual = group_named("gyro_offset").usual_sd
    assert reasons(of(0.99 * MAX_UNLISTED * usual)) == ()
    (reason,) = reasons(of(12.0 * DEG))
    assert "gyros by time, 12 deg/s rms" in reason


def test_a_walk_that_no_device_has_is_a_reason():
    """By how far it led, and not by its density."""
    layout = small_problem().layout
    largest = MAX_UNLISTED * group_named("gyro_offset").usual_sd

    def of(size):
        columns = each(layout.degrees, layout["gyro_offset"], size * np.array([0.3, -1.0, 0.5]))
        return found(contributions=(Contribution(walk_of("gyro_offset"), Source.SENSOR, columns),))

    assert reasons(of(0.95 * largest)) == ()
    (reason,) = reasons(of(1.1 * largest))
    assert "gyro offsets change by more than those of any device" in reason


def test_a_recording_without_standstills_is_not_rejected_for_it():
    assert reasons(facts=replace(FACTS, nis_standstill=float("nan"))) == ()


def with_rejected(*runs):
    """Return an estimate with updates that are rejected: first ones and numbers of runs."""
    run = small_run()
    used = np.ones(run.history.used.size, dtype=bool)
    for first, count in runs:
        used[first : first + count] = False
    return found(run=replace(run, history=replace(run.history, used=used)))


@pytest.mark.parametrize(
    ("runs", "allowed"),
    [(((10, 6),), 5), (((10, 6), (40, 1)), 5), (((10, 5),), 10), (((10, 1), (20, 2), (30, 5)), 10)],
)
def test_one_update_in_twenty_may_be_rejected_or_in_ten_where_it_does_not_last(runs, allowed):
    estimate = with_rejected(*runs)
    assert reasons(estimate, facts=replace(FACTS, rejected=allowed)) == ()
    (reason,) = reasons(estimate, facts=replace(FACTS, rejected=allowed + 1))
    assert f"{allowed + 1} of 100 updates" in reason


def test_halves_that_differ_in_a_sensor_parameter_are_a_reason():
    names = ("gyroscope.offset[0]", "timing.offset")

    def of(*score):
        return SplitHalves(names, np.array(score), np.ones(2))

    assert reasons(halves=of(-0.99 * MAX_SCORE, 100.0)) == ()
    (reason,) = reasons(halves=of(-5.0, 0.0))
    assert "gyroscope.offset[0]" in reason
    assert "5.0 standard deviations" in reason


def test_a_latitude_that_the_gyros_contradict_is_a_reason():
    assert reasons(latitude=LatitudeCheck(49.0, 40.0, 2.0, MAX_SCORE)) == ()
    (reason,) = reasons(latitude=LatitudeCheck(49.25, 40.0, 2.0, MAX_SCORE + 0.01))
    assert "49.25 deg" in reason
    assert "40.0 ± 2 deg" in reason


def far_from_prior(group, deviations):
    """An estimate at its stated prior, but for one parameter of a group."""
    problem = small_problem()
    change = np.zeros(len(problem.parameter_names))
    d = problem.layout[group]
    change[d.stop - 1] = deviations * problem.prior.covariance[group][-1, -1] ** 0.5
    return estimate_of(problem, replace(small_run(), parameters=moved_by(problem, problem.prior.value, change)))


@pytest.mark.parametrize(
    ("group", "said"),
    [("gyro_offset", "gyro offsets"), ("accel_offset", "accelerometer offsets"),
     ("gravity", "gravity")],
)  # fmt: skip
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_estimates_far_from_what_is_stated_are_a_reason(group, said, sign):
    assert reasons(far_from_prior(group, sign * 4.3)) == ()
    (reason,) = reasons(far_from_prior(group, sign * 4.7))
    assert reason.startswith(said)
    score = float(reason.split(" stated standard")[0].split()[-1])
    assert 4.5 < score < 5.0  # the data alone lie farther away than the estimate, which the prior pulls at


def test_offsets_whose_deviation_nobody_stated_may_lie_anywhere():
    far = far_from_prior("gyro_offset", 50.0)
    unstated = replace(far.problem, prior=replace(far.problem.prior, stated=()))
    assert reasons(replace(far, problem=unstated)) == ()


def test_estimates_that_still_move_are_a_reason_unless_the_passes_were_stated():
    assert reasons(found(moved=MAX_MOVED)) == ()
    (reason,) = reasons(found(moved=1.5, passes=10))
    assert "10 passes" in reason
    assert "1.5 standard deviations" in reason
    stated = replace(small_problem(), settings=CalibrationSettings(passes=2))
    assert reasons(found(problem=stated, moved=1.5)) == ()


def test_noise_figures_that_the_data_contradict_are_a_reason():
    assert reasons(found(contradiction=MAX_CONTRADICTION)) == ()
    assert reasons(found(contradiction=3.2)) == ()  # innovations are white, and all else fits
    (reason,) = reasons(replace(found(contradiction=3.2), correlation_factor=1.5))
    assert "the noise found is up to 3.2 times as large" in reason
    (reason,) = reasons(found(contradiction=20.5))
    assert "the noise found is up to 20.5 times as large" in reason


def test_what_a_calibration_needs_must_be_shown():
    def of(*names):
        return replace(SEEN, not_narrowed=names, unobservable=names)

    assert reasons(seen=of("accelerometer.lever_arms[0,0]", "timing.offset", "alignment.tilt[0]")) == ()
    for name in ("gyroscope.cross_coupling[0,0]", "gyroscope.offset[2]", "accelerometer.offset[1]"):
        (reason,) = reasons(seen=of(name))
        assert name in reason
    lost = [f"gyroscope.cross_coupling[0,{i}]" for i in range(3)] + ["gyroscope.offset[0]", "gyroscope.offset[1]"]
    (reason,) = reasons(seen=of(*lost))
    assert [name in reason for name in lost] == [True] * 4 + [False]
    assert "gyroscope.offset[0] and others" in reason
    weak = replace(SEEN, unobservable=("gyroscope.offset[2]",))  # narrowed, but of little use: a gap, no reason
    assert reasons(seen=weak) == ()


@pytest.mark.parametrize(("name", "field"), [("gyroscope", "K_omega"), ("accelerometer", "K_a")])
@pytest.mark.parametrize(("sensitivity", "fine"), [(1.49, True), (1.51, False), (0.68, True), (0.66, False)])
def test_scale_factors_far_from_one_are_a_reason(name, field, sensitivity, fine):
    """A sensor that reads `sensitivity` times too much on all axes, wherever they point."""
    said = reasons(with_matrix(field, np.eye(3) / sensitivity))
    assert [reason.split(" scale")[0] for reason in said] == ([] if fine else [name])


def with_matrix(field, K):
    """An estimate with this cross-coupling matrix, on some mount."""
    run = small_run()
    mount = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    p = replace(run.parameters, sensors=replace(run.parameters.sensors, **{field: mount @ K}))
    return estimate_of(small_problem(), replace(run, parameters=p))


@pytest.mark.parametrize("field", ["K_omega", "K_a"])
def test_axes_that_no_device_has_are_a_reason(field):
    """Axes of one device resemble each other, and are nearly at right angles."""
    assert reasons(with_matrix(field, np.diag([1.0, 0.88, 1.0]))) == ()
    (reason,) = reasons(with_matrix(field, np.diag([1.0, 0.75, 1.0])))
    assert "differ more than those of any device" in reason
    assert reasons(with_matrix(field, np.array([[1.0, 0.08, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))) == ()
    (reason,) = reasons(with_matrix(field, np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])))
    assert "axes are 11 deg off right angles" in reason


def test_each_sensor_has_a_verdict_of_its_own():
    """Accelerometers that the motion does not show are no reason against the gyros, and contradictions are of both."""
    lost = replace(SEEN, unobservable=("accelerometer.offset[1]",), not_narrowed=("accelerometer.offset[1]",))
    said = judge(found(), Evidence(lost, FACTS, None, None))
    assert not said.accepted
    assert said.sensors == {"gyroscope": "accepted", "accelerometer": "not_observable"}
    assert "--only gyroscope would be accepted" in said.sentence
    only = replace(small_problem(), settings=CalibrationSettings(only="gyroscope"))
    said = judge(found(problem=only), Evidence(lost, FACTS, None, None))
    assert said.accepted
    assert said.not_usable == ("accelerometer",)
    assert said.reasons == ()
    assert "accelerometer.offset[1]" in said.unasked[0]
    assert "accelerometers are not observable" in said.summary
    both = judge(found(problem=only), Evidence(lost, replace(FACTS, nis_path=9.0), None, None))
    assert both.sensors == {"gyroscope": "rejected", "accelerometer": "rejected"}
    assert not both.accepted


def test_orientations_alone_are_asked_for_gyros_alone():
    lost = replace(SEEN, unobservable=("accelerometer.offset[1]",), not_narrowed=("accelerometer.offset[1]",))
    problem = small_problem()
    blind = replace(problem, reference=replace(problem.reference, positions=None))
    assert judge(found(problem=blind), Evidence(lost, FACTS, None, None)).accepted


CORRELATION = Correlation(Clock(0.0), 0.987)


def test_consistency_counts_a_rejected_update_by_the_bound_it_was_rejected_at():
    nis = np.array([6.0, 1e6, 12.0, 9.0, 1e6])
    made = history(
        5, nis=nis, degrees=np.array([6.0, 6.0, 6.0, 9.0, 9.0]), used=nis < 1e5,
        at_standstill=np.array([False, False, False, True, True]),
    )  # fmt: skip
    facts = consistency(found(run=replace(small_run(), history=made, fitted=0.0), correlation_factor=1.3), CORRELATION)
    assert facts.nis_path == pytest.approx((6.0 + chi2.isf(1e-6, 6) + 12.0) / 18.0, rel=1e-8)
    assert facts.nis_standstill == pytest.approx((9.0 + chi2.isf(1e-6, 9)) / 18.0, rel=1e-8)
    assert (facts.updates, facts.rejected, facts.correlation_factor, facts.synchronisation) == (5, 2, 1.3, 0.987)


def test_consistency_makes_up_for_degrees_of_freedom_fitted_before():
    made = history(10, nis=np.full(10, 3.0))
    facts = consistency(found(run=replace(small_run(), history=made, fitted=30.0)), CORRELATION)
    assert facts.nis_path == pytest.approx(1.0)
    assert np.isnan(facts.nis_standstill)


def test_correlation_of_neighbours_is_that_of_updates_on_the_path_that_were_used():
    """An autoregressive series of 0.7, 1 / sqrt(n) = 1.6 %; standstills in between would break it."""
    rng, n = np.random.default_rng(0), 4000
    series = rng.normal(size=(n, 9))
    for i in range(1, n):
        series[i] = 0.7 * series[i - 1] + 0.51**0.5 * series[i]
    wide, still = np.zeros((2 * n, 9)), np.arange(2 * n) % 2 == 1
    wide[::2], wide[1::2] = series, 100.0
    made = history(2 * n, whitened=wide, at_standstill=still)
    facts = consistency(found(run=replace(small_run(), history=made)), CORRELATION)
    np.testing.assert_allclose(facts.lag_one, 0.7, atol=4 * 0.016)


def test_the_likeliest_cause_stands_with_a_reason_that_it_may_explain():
    causes = (Cause("gyro_g_sensitivity", "gyros respond to forces", 40.0),)
    reasons = [
        Reason("turn about all axes", motion=True),
        Reason("another device", own=True),
        Reason("the halves differ"),
        Reason("the noise is larger"),
    ]
    assert verdict_by(reasons, SEEN, causes).reasons == (
        "turn about all axes",
        "another device",
        "the halves differ. Likeliest cause: gyros respond to forces",
        "the noise is larger",
    )
    assert verdict_by(reasons[:2], SEEN, causes).reasons == ("turn about all axes", "another device")

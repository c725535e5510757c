"""Devices that are turned by hand, without a reference: deviations hold, and what is no standstill is not used."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.device_axes import turned, upper_triangular
from kreisel.errors import RecordingError
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.lost_share import lost_share
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static
from kreisel.static.static_verdict import MAX_HALVES, judge_static
from kreisel.validation.checks import check_streams


def scores(truth, found):
    """Errors of the usual sensor parameters over their deviations."""
    real = turned(truth, upper_triangular(truth.K_a)[0], np.zeros(3))
    own, sd = found.calibration.sensors, found.calibration.sensor_sd
    parts = [((own.K_omega - real.K_omega) / sd.K_omega).ravel(), (own.k_w[0] - real.k_w[0]) / sd.k_w[0]]
    upper = np.triu_indices(3)
    parts += [((own.K_a - real.K_a)[upper] / sd.K_a[upper]), (own.k_a[0] - real.k_a[0]) / sd.k_a[0]]
    return np.concatenate(parts)


@pytest.mark.parametrize("grade", ["consumer-mems", pytest.param("fog-mems", marks=pytest.mark.slow)])
def test_deviations_hold(grade):
    found = []
    for seed in range(3):
        truth, recording = hand_turned(HandTurns(grade), np.random.default_rng([seed, 77]))
        outcome = calibrate_static(check_streams(recording))
        assert outcome.calibration.accepted, outcome.calibration.verdict
        found.append(scores(truth, outcome))
        np.testing.assert_allclose(
            outcome.calibration.budget.deviation, np.sqrt(np.diag(outcome.calibration.covariance)), rtol=1e-9
        )
    found = np.concatenate(found)
    assert np.abs(found).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("laid", ["faces", "whole turns", "turntable"])
def test_deviations_hold_for_what_else_is_known(laid):
    found = []
    for seed in range(3):
        how = HandTurns("fog-mems", attitudes=12, laid=laid)
        truth, recording = hand_turned(how, np.random.default_rng([seed, 78]))
        outcome = calibrate_static(check_streams(recording))
        assert outcome.calibration.accepted, outcome.calibration.verdict
        found.append(scores(truth, outcome))
    found = np.concatenate(found)
    assert np.abs(found).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.4


def test_faces_by_a_stop_on_a_slope_do_not_look_like_square_terms():
    found = []
    for seed in range(4):
        how = HandTurns(attitudes=12, laid="faces", by_a_stop=True, laid_error=1e-3, slope=(0.02, -0.015))
        truth, recording = hand_turned(how, np.random.default_rng([seed, 80]))
        outcome = calibrate_static(check_streams(recording))
        assert outcome.method == "six-position"
        assert outcome.calibration.accepted, outcome.calibration.verdict
        assert outcome.calibration.sensor_sd.k_a[0].max() < 5e-3
        found.append(scores(truth, outcome))
    found = np.concatenate(found)
    assert np.abs(found).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize(("spin", "sd"), [(0.0, 4e-4), (40.0, 6e-5)])
def test_a_hinge_and_a_drill_show_the_gyros_whatever_their_angles(spin, sd):
    """Scale factors are 2 % off: forty revolutions by these are nearly a whole one off."""
    found = []
    for seed in range(3):
        how = HandTurns(attitudes=15, laid="hinge", table_axis=(0.96, 0.28, 0.05), spin=spin, off_axis=0.03)
        truth, recording = hand_turned(how, np.random.default_rng([seed, 79]))
        outcome = calibrate_static(check_streams(recording))
        assert outcome.method == "hinge"
        assert outcome.calibration.accepted, outcome.calibration.verdict
        assert np.diag(outcome.calibration.sensor_sd.K_omega).max() < sd
        found.append(scores(truth, outcome))
    found = np.concatenate(found)
    assert np.abs(found).max() < 4.0
    assert 0.5 < np.sqrt(np.mean(found**2)) < 1.4


@pytest.mark.parametrize(
    ("error", "shown"),
    [
        (lambda angle: 3e-3 * np.sin(angle + 1.0), True),
        pytest.param(lambda angle: 1.5e-3 * np.sin(2.0 * angle + 0.4), True, marks=pytest.mark.slow),
        pytest.param(np.zeros_like, False, marks=pytest.mark.slow),
    ],
    ids=["once a revolution", "twice a revolution", "centred"],
)
def test_an_encoder_of_a_table_that_is_not_centred_is_found(error, shown):
    """Its waves had looked like a play and cubic terms, with gyros' scale factors nine deviations off."""
    how = HandTurns("industrial-mems", attitudes=24, laid="turntable", rest=2.0)
    truth, recording = hand_turned(how, np.random.default_rng([1, 82]))
    table = replace(recording.table, angles=recording.table.angles + error(recording.table.angles))
    outcome = calibrate_static(check_streams(replace(recording, table=table)))
    assert outcome.calibration.accepted, outcome.calibration.verdict
    assert any("in waves once and twice a revolution" in one.message for one in outcome.warnings) is shown
    assert "gyro_cubic" not in outcome.found.problem.effects
    assert np.abs(scores(truth, outcome)).max() < 4.0


def test_a_table_whose_scale_is_wrong_is_contradicted_by_turns_by_hand():
    """The gyros' scale factors would be 1 % off, and nothing but the turns from one mounting to the next shows it."""
    how = HandTurns("industrial-mems", attitudes=18, laid="turntable")
    _, recording = hand_turned(how, np.random.default_rng(81))
    wrong = replace(recording.table, angles=1.01 * recording.table.angles)
    assert not calibrate_static(check_streams(replace(recording, table=wrong))).calibration.accepted
    outcome = calibrate_static(check_streams(recording))
    assert outcome.calibration.accepted
    by_hand = np.setdiff1d(outcome.found.rows["turn"].node, outcome.found.problem.known[0].node)
    assert by_hand.size == 2
    deviation = np.sqrt(np.diag(outcome.calibration.covariance))
    at = np.isin(outcome.found.rows["turn"].node, by_hand)
    for count in (1, 2):
        inflated = np.where(at & (np.cumsum(at) <= count), 1e9, 0.0)
        against = replace(outcome.found, inflated={"turn": inflated})
        assert [node for _, node in against.left_out] == by_hand[:count].tolist()
        assert judge_static(against, deviation, None, None).accepted == (count < 2)


def test_a_turntables_clock_is_that_by_which_most_of_its_turns_agree():
    """By a clock that is 145 s off, and 4 % fast, the rates of this one are more alike, and a single turn agrees."""
    name = "turntable, fog-mems"
    how = HandTurns("fog-mems", attitudes=12, laid="turntable")
    truth, recording = hand_turned(how, np.random.default_rng([1130, *name.encode()]))
    found = calibrate_static(check_streams(recording))
    (known,) = found.found.problem.known
    assert known.node.size == 9
    assert np.abs(scores(truth, found)).max() < 4.0


def test_a_turntables_clock_may_be_a_percent_off():
    how = HandTurns("fog-mems", attitudes=12, laid="turntable")
    truth, recording = hand_turned(how, np.random.default_rng(83))
    table = recording.table
    stamps = table.stamps_ns[0] + (1.01 * (table.stamps_ns - table.stamps_ns[0])).astype(np.int64) + 3_000_000_000
    found = calibrate_static(check_streams(replace(recording, table=replace(table, stamps_ns=stamps))))
    assert found.calibration.accepted
    assert np.abs(scores(truth, found)).max() < 4.0
    assert any("differ by +1.0 %" in warning.message for warning in found.warnings)
    assert 0.009 < np.diag(found.calibration.sensor_sd.K_omega).min() < 0.011


@pytest.mark.slow
def test_offsets_that_wander_during_long_turns_are_errors_of_these_turns():
    """Flicker noise of 20 deg/h for half a minute is more than any error of the encoder."""
    name = "turntable, level axis"
    how = HandTurns(attitudes=18, laid="turntable", table_axis=(1.0, 0.0, 0.0))
    worst = []
    for number in (701, 708):
        truth, recording = hand_turned(how, np.random.default_rng([number, *name.encode()]))
        worst.append(np.abs(scores(truth, calibrate_static(check_streams(recording)))).max())
    assert max(worst) < 4.0  # 4.4 and 5.3 where they count as constant between two standstills


def test_a_device_that_is_hardly_tilted_is_not_calibrated():
    """The gyros turn, though: they may be used."""
    _, recording = hand_turned(HandTurns(tilt=np.radians(10.0)), np.random.default_rng(1))
    found = calibrate_static(check_streams(recording))
    assert not found.calibration.accepted
    assert "not observable with these standstills" in found.calibration.verdict.reasons[0]
    assert found.calibration.verdict.sensors["accelerometer"] == "not_observable"


def test_a_standstill_that_creeps_is_none_and_one_that_slips_is_left_out():
    rng = np.random.default_rng(2)
    truth, recording = hand_turned(HandTurns(creep=0.05), rng)
    with pytest.raises(RecordingError, match="standstill"):
        calibrate_static(check_streams(recording))
    truth, recording = hand_turned(HandTurns(slip=0.01), rng)
    found = calibrate_static(check_streams(recording))
    assert np.abs(scores(truth, found)).max() < 4.0


def test_a_turn_across_lost_samples_says_nothing():
    _, recording = hand_turned(HandTurns(attitudes=14), np.random.default_rng(3))
    rests = find_rests(recording.imu)
    keep = np.ones(recording.imu.stamps_ns.size, dtype=bool)
    between = (int(rests.last[4]) + int(rests.first[5])) // 2
    keep[between - 20 : between + 20] = False
    imu = replace(
        recording.imu, stamps_ns=recording.imu.stamps_ns[keep], rates=recording.imu.rates[keep],
        accelerations=recording.imu.accelerations[keep],
    )  # fmt: skip
    found = calibrate_static(check_streams(replace(recording, imu=imu))).found
    assert found.problem.rests.count == rests.count
    assert found.linear.turn.node.tolist() == [k for k in range(rests.count - 1) if k != 4]


def test_samples_lost_without_a_gap_are_said_and_widen_the_gyro_scale():
    truth, recording = hand_turned(HandTurns(lost=0.03), np.random.default_rng(5))
    found = calibrate_static(check_streams(recording))
    assert any("samples are lost without a gap" in warning.message for warning in found.warnings)
    assert np.abs(scores(truth, found)).max() < 4.0
    assert np.diag(found.calibration.sensor_sd.K_omega).min() > 3e-3
    _, whole = hand_turned(HandTurns(), np.random.default_rng(5))
    assert lost_share(whole.imu, find_rests(whole.imu)) == (0.0, 0.0)


@pytest.mark.parametrize("width", [2.0, 2.5, 3.0])
def test_a_hand_that_jerks_loses_no_samples(width):
    """Rates that rise and fall within some samples: the step in the middle is larger than those beside it."""
    rng, count = np.random.default_rng(9), 20_000
    t = np.arange(count)
    rates = rng.normal(0.0, 3e-3, (count, 3))
    for at in rng.uniform(100.0, count - 100.0, 300):
        rates += np.exp(-0.5 * ((t - at) / width) ** 2)[:, None] * rng.normal(0.0, 2.0, 3)
    _, recording = hand_turned(HandTurns(), np.random.default_rng(5))
    imu = replace(
        recording.imu, stamps_ns=t * 10_000_000, rates=rates, accelerations=np.zeros((count, 3)), temperature=None
    )
    rests = replace(find_rests(recording.imu), density_w=np.full(3, 3e-4))
    assert lost_share(imu, rests)[0] == 0.0
    assert lost_share(imu, rests, 1e-3)[1] <= 4e-4


def test_samples_that_are_missing_with_their_stamps_widen_nothing():
    truth, recording = hand_turned(HandTurns(), np.random.default_rng(5))
    imu, kept = recording.imu, np.random.default_rng(1).random(recording.imu.stamps_ns.size) > 0.08
    fewer = replace(
        imu, stamps_ns=imu.stamps_ns[kept], rates=imu.rates[kept], accelerations=imu.accelerations[kept],
    )  # fmt: skip
    assert lost_share(fewer, find_rests(fewer)) == (0.0, 0.0)
    found = calibrate_static(check_streams(replace(recording, imu=fewer)))
    assert found.calibration.accepted, found.calibration.verdict
    assert np.abs(scores(truth, found)).max() < 4.0
    assert [one.subject for one in found.warnings].count("gaps") == 1


def test_an_axis_that_never_changes_is_the_reason():
    _, recording = hand_turned(HandTurns(attitudes=16), np.random.default_rng(8))
    recording.imu.rates[:, 2] = 0.01
    verdict = calibrate_static(check_streams(recording)).calibration.verdict
    assert not verdict.accepted
    assert verdict.reasons == ("gyroscope: the readings of z never change: it is not connected, or broken",)


@pytest.mark.slow
def test_without_gyros_the_accelerometers_are_calibrated():
    truth, recording = hand_turned(HandTurns(attitudes=24), np.random.default_rng(8))
    recording.imu.rates[:] = 0.0
    found = calibrate_static(check_streams(recording), only="accelerometer")
    assert found.calibration.accepted, found.calibration.verdict
    assert found.calibration.verdict.sensors == {"gyroscope": "not_observable", "accelerometer": "accepted"}
    real = turned(truth, upper_triangular(truth.K_a)[0], np.zeros(3))
    upper = np.triu_indices(3)
    score = (found.calibration.sensors.K_a - real.K_a)[upper] / found.calibration.sensor_sd.K_a[upper]
    assert np.abs(score).max() < 4.0


def test_without_standstills_it_says_so():
    _, recording = hand_turned(HandTurns(attitudes=4), np.random.default_rng(4))
    with pytest.raises(RecordingError, match="4 standstills, expected 6 or more in different attitudes"):
        calibrate_static(check_streams(recording))


@pytest.mark.slow
def test_halves_that_lack_a_mounting_of_a_hinge_do_not_contradict_each_other():
    """What a half does not show is not compared: 4.1 deviations by a step of a tenth of a scale factor."""
    how = HandTurns("industrial-mems", attitudes=48, laid="hinge", table_axis=(1.0, 0.0, 0.03), rest=2.0)
    _, recording = hand_turned(how, np.random.default_rng([2, 83]))
    outcome = calibrate_static(check_streams(recording))
    assert outcome.calibration.accepted
    assert np.abs(outcome.halves).max() < 3.0


def test_halves_that_differ_are_a_reason_against_the_sensor_they_concern():
    _, recording = hand_turned(HandTurns(attitudes=16), np.random.default_rng(7))
    found = calibrate_static(check_streams(recording)).found
    halves = np.zeros(found.problem.layout.degrees)
    halves[found.problem.layout["accel_offset"].start + 1] = -MAX_HALVES - 1.0
    verdict = judge_static(found, found.deviation, halves, None)
    assert verdict.reasons == (
        "both halves of the recording differ by 5.5 deviations in accelerometer.offset[1]: something changed that is "
        "not modelled",
    )
    assert verdict.sensors == {"gyroscope": "accepted", "accelerometer": "rejected"}
    assert judge_static(found, found.deviation, halves, "gyroscope").accepted


def test_revolutions_that_nothing_counts_are_not_used():
    """About an axis four degrees from upright one revolution more fits as well: by 40 of them, 2.5 % of scale."""
    how = HandTurns(attitudes=12, laid="hinge", table_axis=(0.07, 0.0, 1.0), table_tilt=0.0, spin=40.0)
    truth, recording = hand_turned(how, np.random.default_rng([1, 80]))
    found = calibrate_static(check_streams(recording))
    assert any("that nothing counts" in str(warning) for warning in found.warnings)
    assert np.abs(scores(truth, found)).max() < 4.0

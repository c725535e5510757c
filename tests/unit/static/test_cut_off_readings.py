"""Readings that a device cuts off, or that were written with wrong signs or in the wrong order."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.rate_size import check_rate_size
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static
from kreisel.static.vertical_turn import vertical_turn
from kreisel.validation.checks import check_streams


@pytest.fixture(scope="module")
def whole():
    return hand_turned(HandTurns("industrial-mems", attitudes=24, rest=3.0), np.random.default_rng(3))[1]


def changed(recording, rates=None, accelerations=None):
    imu = recording.imu
    new = {"rates": rates, "accelerations": accelerations}
    return check_streams(replace(recording, imu=replace(imu, **{k: v for k, v in new.items() if v is not None})))


@pytest.fixture(scope="module")
def from_all(whole):
    return calibrate_static(changed(whole)).calibration


def worst(outcome, from_all):
    """Return the largest difference of a matrix from that by readings that are not cut off, in deviations."""
    found, sd = outcome.calibration.sensors, outcome.calibration.sensor_sd
    scores = [
        np.abs(getattr(found, name) - getattr(from_all.sensors, name)) / np.where(own > 0.0, own, np.inf)
        for name, own in (("K_omega", sd.K_omega), ("K_a", sd.K_a))
    ]
    return float(np.max(scores))


@pytest.mark.parametrize(("channel", "spikes", "said"), [(0, 0, ""), (2, 0, ""), (1, 1, " but for one reading")])
def test_an_accelerometer_that_never_changes_is_named(whole, channel, spikes, said):
    forces = whole.imu.accelerations.copy()
    forces[:, channel] = 0.034
    forces[2000 : 2000 + spikes, channel] = 40.0
    with pytest.raises(RecordingError, match=rf"dead channel: a_{'xyz'[channel]} \(always 0.034{said}\) never changes"):
        calibrate_static(changed(whole, accelerations=forces))


def test_turns_with_gyros_at_the_end_of_their_range_are_not_used(whole, from_all):
    limit = 0.8 * np.abs(whole.imu.rates).max()
    outcome = calibrate_static(changed(whole, rates=np.clip(whole.imu.rates, -limit, limit)))
    said = [str(one) for one in outcome.warnings if one.subject == "turns"]
    assert len(said) == 1
    assert "end of its range" in said[0]
    used = outcome.found.rows["turn"].node.size
    assert 0 < len(outcome.found.problem.unused) == outcome.found.problem.rests.count - 1 - used
    assert worst(outcome, from_all) < 3.0


@pytest.mark.parametrize("factor", [0.5, 2.0, 20.0])
def test_rates_that_are_all_too_large_are_refused_with_the_factor(whole, factor):
    with pytest.raises(RecordingError, match="turns agree with gravity only if all rates are multiplied") as raised:
        calibrate_static(changed(whole, rates=factor * whole.imu.rates))
    said = float(str(raised.value).split("multiplied by ")[1].split(":")[0])
    assert said * factor == pytest.approx(1.0, rel=0.05)


def test_rates_that_no_factor_makes_fit_are_not_refused_for_it(whole):
    check_rate_size(whole.imu, find_rests(whole.imu))
    mirrored = replace(whole.imu, rates=whole.imu.rates * [1.0, -1.0, 1.0])
    check_rate_size(mirrored, find_rests(mirrored))


def test_turns_in_which_a_gyro_wraps_round_are_not_used(whole, from_all):
    limit = 0.7 * np.abs(whole.imu.rates).max()
    outcome = calibrate_static(changed(whole, rates=(whole.imu.rates + limit) % (2.0 * limit) - limit))
    assert len(outcome.found.problem.unused) > 0
    assert outcome.calibration.accepted
    assert worst(outcome, from_all) < 3.0


def test_spikes_of_single_samples_are_not_used(whole, from_all):
    rng = np.random.default_rng(6)
    rates, forces = whole.imu.rates.copy(), whole.imu.accelerations.copy()
    at = rng.choice(len(rates), 30, replace=False)
    rates[at[:15], at[:15] % 3] += rng.choice([-1.0, 1.0], 15) * rng.uniform(5.0, 30.0, 15)
    forces[at[15:], at[15:] % 3] += rng.choice([-1.0, 1.0], 15) * rng.uniform(20.0, 60.0, 15)
    outcome = calibrate_static(changed(whole, rates=rates, accelerations=forces))
    assert any("samples that are spikes" in str(one) for one in outcome.warnings)
    assert outcome.calibration.accepted
    assert worst(outcome, from_all) < 3.0


def test_gyros_are_not_accepted_alone_where_turns_miss_readings(whole):
    """In a third of the turns 0.2 s are missing while the stamps go on."""
    rests = find_rests(whole.imu)
    keep = np.ones(len(whole.imu.stamps_ns), dtype=bool)
    for a, b in list(zip(rests.last[:-1], rests.first[1:], strict=True))[::3]:
        middle = (a + b) // 2
        keep[middle : middle + round(0.2 / whole.imu.interval)] = False
    imu = whole.imu
    part = replace(
        imu, stamps_ns=imu.stamps_ns[: keep.sum()], rates=imu.rates[keep], accelerations=imu.accelerations[keep]
    )
    outcome = calibrate_static(check_streams(replace(whole, imu=part)), only="gyroscope")
    assert not outcome.calibration.accepted


def test_one_turn_that_no_readings_show_is_left_out(whole, from_all):
    """Two files joined in a standstill: the attitude changes between two samples, and noise figures would hide it."""
    imu, rests = whole.imu, find_rests(whole.imu)
    middle = (rests.first + rests.last) // 2
    keep = np.r_[0 : middle[10], middle[12] : len(imu.stamps_ns)]
    part = replace(
        imu, stamps_ns=imu.stamps_ns[: keep.size], rates=imu.rates[keep], accelerations=imu.accelerations[keep]
    )
    outcome = calibrate_static(check_streams(replace(whole, imu=part)))
    assert outcome.calibration.accepted
    assert any(kind == "turn" for kind, _ in outcome.found.left_out)
    assert worst(outcome, from_all) < 3.0


def silenced(recording):
    """Return a recording whose device sets rates to zero from half a second after it comes to rest."""
    rests = find_rests(recording.imu)
    rates = recording.imu.rates.copy()
    late = round(0.5 / recording.imu.interval)
    for a, b in zip(rests.first, rests.last, strict=True):
        rates[a + late : b + late // 10] = 0.0
    return changed(recording, rates=rates)


def test_a_device_that_sets_its_rates_to_zero_at_rest_has_its_offsets_in_motion(whole, from_all):
    outcome = calibrate_static(silenced(whole))
    assert outcome.calibration.accepted
    assert any("sets its rates to zero" in str(one) for one in outcome.warnings)
    assert worst(outcome, from_all) < 3.0
    found, sd = outcome.calibration.sensors, outcome.calibration.sensor_sd
    off = (found.k_w[0] - from_all.sensors.k_w[0]) / sd.k_w[0]
    assert np.abs(off).max() < 3.0
    assert np.abs(found.k_w[0]).max() > 4.0 * sd.k_w[0].max()  # zeros would be far off


def test_standstills_with_accelerometers_at_the_end_of_their_range_are_not_used(whole, from_all):
    clipped = np.clip(whole.imu.accelerations, -9.0, 9.0)
    outcome = calibrate_static(changed(whole, accelerations=clipped))
    rests = outcome.found.problem.rests
    assert rests.clipped > 0
    assert np.abs(rests.forces).max() < 9.0
    assert any(f"not used: {rests.clipped}" in str(one) for one in outcome.warnings)
    assert worst(outcome, from_all) < 3.0


def test_too_few_standstills_are_left_of_a_range_that_is_too_small(whole):
    with pytest.raises(RecordingError, match="more a reading is at the end of its range"):
        calibrate_static(changed(whole, accelerations=np.clip(whole.imu.accelerations, -5.0, 5.0)))


def test_readings_in_steps_are_not_cut_off(whole):
    """Readings of two digits repeat at every standstill, and at the largest value, too."""
    rounded = np.round(whole.imu.accelerations / 0.15) * 0.15
    assert calibrate_static(changed(whole, accelerations=rounded)).found.problem.rests.clipped == 0


@pytest.mark.parametrize(
    ("rates", "accelerations", "said"),
    [
        (None, [[0, 1, 1], [1, 2, 1], [2, 0, 1]], "rotated by"),
        ([[0, 1, 1], [1, 2, 1], [2, 0, 1]], None, "rotated by 120 deg"),
        ([[0, 2, 1], [1, 0, 1], [2, 1, 1]], None, "rotated by 120 deg"),
        (None, [[0, 0, -1], [1, 1, 1], [2, 2, 1]], "left-handed triad against the gyros (-a_x lies along w_x, a_y"),
        (None, [[0, 0, 1], [1, 2, 1], [2, 1, 1]], "a_z lies along w_y, a_y lies along w_z"),
        ([[0, 0, 1], [1, 1, 1], [2, 2, -1]], None, "the gyro axes form a left-handed triad"),
        ([[0, 1, 1], [1, 0, 1], [2, 2, 1]], None, "the gyro axes form a left-handed triad"),
    ],
    ids=["turned", "gyros turned", "gyros turned back", "flipped", "swapped", "gyro flipped", "gyros swapped"],
)
def test_columns_in_disorder_are_named(whole, rates, accelerations, said):
    imu = whole.imu

    def written(values, order):
        return None if order is None else np.stack([sign * values[:, i] for _, i, sign in order], axis=1)

    with pytest.raises(RecordingError) as caught:
        calibrate_static(changed(whole, written(imu.rates, rates), written(imu.accelerations, accelerations)))
    assert said in str(caught.value)


@pytest.mark.parametrize(("latitude", "found"), [(48.0, None), (-48.0, 48.0), (10.0, 48.0)])
def test_a_latitude_that_the_earths_rotation_contradicts_is_found(latitude, found):
    recording = hand_turned(HandTurns("fog", attitudes=24, rest=3.0), np.random.default_rng(5))[1]
    site = recording.settings.site.model_copy(update={"latitude_deg": latitude})
    settings = recording.settings.model_copy(update={"site": site})
    outcome = calibrate_static(check_streams(replace(recording, settings=settings)))
    turn = vertical_turn(outcome.found)
    assert outcome.calibration.accepted == (found is None)
    if found is None:
        assert turn is None
    else:
        assert abs(turn.found_deg - found) < 4.0 * turn.latitude_sd_deg
        assert any("contradicts the Earth's rotation" in reason for reason in outcome.calibration.verdict.reasons)

"""The IMU's noise: as stated, by grade, or as drawn and found again; and its readings split at gaps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.inertial.noise_figures import GRADES
from kreisel.preparation.imu_noise import imu_noise_of, readings_of
from kreisel.recording.recording import Datasheet, ImuSamples, Recording
from kreisel.recording.recording_settings import ImuTable, RecordingSettings

STEP_NS, COUNT = 2_500_000, 20_000
STEP = STEP_NS * 1e-9
GYRO, ACCEL = np.array([1e-5, 2e-5, 4e-5]), np.array([2e-4, 1e-4, 5e-4])
"""Densities of what is drawn."""

LIKELY = 0.05
"""The median of COUNT squares scatters by 1.2 %, for neighbouring third differences share noise by somewhat more."""


def samples_of(stamps, rates, accelerations):
    return ImuSamples(np.asarray(stamps, dtype=np.int64), rates, accelerations, Path("run/imu0/data.csv"))


@pytest.fixture(scope="module")
def imu():
    """A second's motion, over and over, and white noise."""
    rng = np.random.default_rng(5)
    t = np.arange(COUNT) * STEP
    motion = np.sin(2.0 * np.pi * t)[:, None]
    rates, forces = (
        size * motion + rng.normal(0.0, 1.0, (COUNT, 3)) * density / np.sqrt(STEP)
        for size, density in ((1.0, GYRO), (5.0, ACCEL))
    )
    return samples_of(np.arange(COUNT) * STEP_NS, rates, forces)


@pytest.fixture(scope="module")
def resting(imu):
    """The same with rests: every other second of ten."""
    t = np.arange(COUNT) * STEP
    motion = (np.sin(2.0 * np.pi * t) * (t % 20.0 < 10.0))[:, None] * [1.0, 1.0, 1.0]
    smooth = np.sin(2.0 * np.pi * t)[:, None]
    return replace(
        imu, rates=imu.rates - smooth + motion, accelerations=imu.accelerations - 5.0 * smooth + 5.0 * motion
    )


def recording_of(imu, datasheet=None, **table):
    return Recording(Path("run"), imu, None, settings=RecordingSettings(imu=ImuTable(**table)), datasheet=datasheet)


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_noise_that_nobody_stated_is_that_of_the_readings(imu):
    noise = imu_noise_of(recording_of(imu))
    np.testing.assert_allclose(noise.gyro, GYRO, rtol=LIKELY)
    np.testing.assert_allclose(noise.accel, ACCEL, rtol=LIKELY)
    assert not noise.given
    assert (noise.gyro_offset_sd, noise.accel_offset_sd) == (None, None)
    assert (noise.gyro_walk, noise.accel_walk) == (0.0, 0.0)
    assert noise.gyro_scatter == pytest.approx(rms(GYRO) / np.sqrt(STEP), rel=LIKELY)


def test_readings_without_noise_are_given_some():
    still = samples_of(np.arange(100) * STEP_NS, np.zeros((100, 3)), np.zeros((100, 3)))
    noise = imu_noise_of(recording_of(still))
    np.testing.assert_array_equal(noise.gyro, 1e-7)
    np.testing.assert_array_equal(noise.accel, 1e-6)


def test_what_is_stated_holds_whatever_the_readings_show(imu):
    noise = imu_noise_of(
        recording_of(imu, gyro_noise_density=9e-6, accel_noise_density=3e-4, gyro_offset_sd=1e-3, accel_offset_sd=2e-2)
    )
    np.testing.assert_array_equal(noise.gyro, 9e-6)
    np.testing.assert_array_equal(noise.accel, 3e-4)
    assert noise.given
    assert (noise.gyro_offset_sd, noise.accel_offset_sd) == (1e-3, 2e-2)
    assert noise.gyro_scatter == pytest.approx(9e-6 / np.sqrt(STEP), rel=1e-12)  # less than the readings show


def test_each_sensor_is_stated_by_itself(imu):
    noise = imu_noise_of(recording_of(imu, accel_noise_density=2e-4))
    np.testing.assert_array_equal(noise.accel, 2e-4)
    np.testing.assert_allclose(noise.gyro, GYRO, rtol=LIKELY)


def test_a_grade_states_what_the_user_does_not(imu):
    grade = GRADES["industrial-mems"]
    noise = imu_noise_of(recording_of(imu, grade="industrial-mems", gyro_noise_density=9e-6, accel_offset_sd=2e-2))
    np.testing.assert_array_equal(noise.gyro, 9e-6)
    np.testing.assert_array_equal(noise.accel, grade.accel_noise_density)
    assert (noise.gyro_offset_sd, noise.accel_offset_sd) == (grade.gyro_offset_sd, 2e-2)
    assert noise.given


def test_a_grade_too_noisy_for_the_readings_does_not_make_single_readings_noisier(imu):
    noise = imu_noise_of(recording_of(imu, grade="consumer-mems"))
    assert GRADES["consumer-mems"].gyro_noise_density > 2.0 * rms(GYRO)
    assert noise.gyro_scatter == pytest.approx(rms(GYRO) / np.sqrt(STEP), rel=LIKELY)


def test_flicker_noise_of_a_grade_becomes_a_walk_that_changes_as_much_in_ten_minutes(imu):
    """K^2 T = 2 B^2 / pi (ln(2 pi T / 100 s) + 0.577) for T = 600 s, and the grade's own walk beside it."""
    grade = GRADES["fog-mems"]
    noise = imu_noise_of(recording_of(imu, grade="fog-mems"))
    per_b = np.sqrt(2.0 / np.pi * (np.log(12.0 * np.pi) + 0.5772157) / 600.0)
    assert grade.gyro_rate_random_walk == grade.accel_random_walk == 0.0
    assert noise.gyro_walk == pytest.approx(per_b * grade.gyro_bias_instability, rel=1e-7)
    assert noise.accel_walk == pytest.approx(per_b * grade.accel_bias_instability, rel=1e-7)


SHEET = Datasheet(3e-5, 3e-4, 7e-6, 8e-5)


def test_a_data_sheet_is_a_lower_bound_and_states_the_walks(imu):
    noise = imu_noise_of(recording_of(imu, SHEET))
    np.testing.assert_allclose(noise.gyro, [3e-5, 3e-5, 4e-5], rtol=LIKELY)
    np.testing.assert_allclose(noise.accel, [3e-4, 3e-4, 5e-4], rtol=LIKELY)
    assert noise.gyro[0] == 3e-5
    assert (noise.gyro_walk, noise.accel_walk) == (7e-6, 8e-5)
    assert not noise.given


def test_the_users_word_goes_before_a_data_sheet(imu):
    noise = imu_noise_of(recording_of(imu, SHEET, grade="fog-mems"))
    np.testing.assert_array_equal(noise.gyro, GRADES["fog-mems"].gyro_noise_density)
    assert (noise.gyro_walk, noise.accel_walk) == (7e-6, 8e-5)  # the walks are stated


def test_the_data_may_move_the_noise_from_what_is_stated_to_well_above_what_shows(imu):
    noise = imu_noise_of(recording_of(imu, gyro_noise_density=9e-6, accel_noise_density=0.1))
    assert noise.gyro_bounds == pytest.approx((9e-6, 20.0 * rms(GYRO)), rel=LIKELY)
    assert noise.accel_bounds == (0.1, 0.1)  # stated above all that shows
    shown = imu_noise_of(recording_of(imu))
    assert shown.gyro_bounds == pytest.approx((0.95 * rms(GYRO), 20.0 * rms(GYRO)), rel=LIKELY)


def with_gaps(imu, *after):
    """Readings with a second missing after some samples."""
    late = np.searchsorted(after, np.arange(imu.stamps_ns.size), side="left")
    return replace(imu, stamps_ns=imu.stamps_ns + late * 1_000_000_000)


def test_readings_are_split_at_long_gaps_and_short_pieces_left_out(imu):
    part = samples_of(imu.stamps_ns[:200], imu.rates[:200], imu.accelerations[:200])
    broken = with_gaps(part, 79, 98, 118, 139)  # pieces of 80, 19, 20, 21 and 60 samples
    noise = imu_noise_of(recording_of(imu))
    found = readings_of(recording_of(broken), noise)
    assert found.segments == ((0, 79), (99, 118), (119, 139), (140, 199))
    np.testing.assert_allclose(np.diff(found.stamps)[[79, 0]], [1.0 + STEP, STEP], rtol=1e-9)
    np.testing.assert_array_equal(found.rates, part.rates)


@pytest.mark.parametrize(("missing", "pieces"), [(15, 1), (25, 2)])
def test_a_gap_is_long_from_fifty_milliseconds_on(imu, missing, pieces):
    keep = np.r_[0:100, 100 + missing : 300]
    part = samples_of(imu.stamps_ns[keep], imu.rates[keep], imu.accelerations[keep])
    assert len(readings_of(recording_of(part), imu_noise_of(recording_of(imu))).segments) == pieces


def test_pieces_all_too_short_are_refused(imu):
    part = samples_of(imu.stamps_ns[:50], imu.rates[:50], imu.accelerations[:50])
    noise = imu_noise_of(recording_of(imu))
    with pytest.raises(RecordingError, match=r"imu0/data\.csv: no .*20 samples"):
        readings_of(recording_of(with_gaps(part, 18, 37)), noise)


def test_readings_carry_spectral_densities_and_how_much_they_bend():
    t = np.arange(8000) * STEP
    w, size = np.array([20.0, 30.0, 50.0]), np.array([1.0, 2.0, 0.5])
    rates = size * np.sin(t[:, None] * w)
    sine = samples_of(np.arange(8000) * STEP_NS, rates, 3.0 * rates)
    noise = imu_noise_of(recording_of(sine, gyro_noise_density=1e-5, accel_noise_density=2e-4))
    found = readings_of(recording_of(sine), noise).noise
    np.testing.assert_allclose(found[:2], [[1e-10] * 3, [4e-8] * 3], rtol=1e-12)
    # nine tenths of a sine's sizes lie below sin(0.9 pi / 2); differences over a step flatten it by (w STEP)^2 / 12
    usual = size * w**2 * np.sin(0.45 * np.pi)
    np.testing.assert_allclose(found[2:], [usual, 3.0 * usual], rtol=0.003)


@pytest.mark.parametrize(("factor", "used"), [(1.2, "stated"), (3.0, "at rest"), (6.0, "nothing")])
def test_what_is_stated_of_sensors_that_are_noisier_at_rest(resting, factor, used):
    """A little noisier is by chance; much noisier is another device, and the spread of the offsets is its own, too."""
    noise = imu_noise_of(recording_of(resting, gyro_noise_density=rms(GYRO) / factor, gyro_offset_sd=1e-3))
    if used == "nothing":
        assert noise.misstated["gyros"] == pytest.approx(factor, rel=0.15)
        np.testing.assert_allclose(noise.gyro, GYRO, rtol=LIKELY)
        assert noise.gyro_offset_sd is None
        assert not noise.given
        return
    assert noise.misstated == {}
    assert noise.gyro_offset_sd == 1e-3
    density = rms(GYRO) if used == "at rest" else rms(GYRO) / factor
    np.testing.assert_allclose(noise.gyro, density, rtol=0.1 if used == "at rest" else 1e-12)
    assert set(noise.doubtful) == ({"gyros"} if used == "at rest" else set())


def test_readings_that_never_rest_say_nothing_of_what_is_stated(imu):
    """Their noise may be that of a shaken sensor."""
    noise = imu_noise_of(recording_of(imu, gyro_noise_density=rms(GYRO) / 6.0))
    assert noise.misstated == noise.doubtful == {}
    np.testing.assert_allclose(noise.gyro, rms(GYRO) / 6.0)


def test_a_grade_is_of_both_sensors(resting):
    """These accelerometers are a little noisier than the grade's, these gyros twenty times."""
    noise = imu_noise_of(recording_of(resting, grade="ring-laser"))
    assert set(noise.misstated) == {"gyros", "accelerometers"}
    assert (noise.gyro_offset_sd, noise.accel_offset_sd, noise.gyro_walk, noise.gyro_gauss_markov) == (
        None,
        None,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(("step", "coarse"), [(1e-2, True), (1e-4, False)])
def test_coarse_rounding_is_an_error_that_passes(imu, step, coarse):
    """At rest noise of 1e-3 rad/s does not reach the next step of ten times that; its error is uniform."""
    rates = np.random.default_rng(3).normal(0.0, 1e-3, (COUNT, 3))
    t = np.arange(COUNT)[:, None] * STEP
    rates += np.where(t % 4.0 < 2.0, np.sin(np.pi * t), 0.0)  # two seconds of motion, two of rest
    noise = imu_noise_of(recording_of(replace(imu, rates=np.round(rates / step) * step)))
    assert noise.gyro_gauss_markov == pytest.approx(step / 12.0**0.5 if coarse else 0.0, rel=1e-9)

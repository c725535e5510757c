"""Sums and means over lost samples, of sensors that accumulate until they are read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples
from kreisel.validation.accumulated_readings import with_lost_samples, with_steps_of_one

INTERVAL_NS = 5_000_000
COUNT = 4000
PLACES = (300, 720, 1050, 1610, 2000, 2300, 2810, 3333)


def increments(seed=0):
    """Return rates and forces (n, 3) of a lively motion, with noise."""
    rng = np.random.default_rng(seed)
    t = 1e-9 * INTERVAL_NS * np.arange(COUNT)
    rates = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t + 1.0), np.sin(1.3 * t) * np.cos(4.0 * t)])
    forces = np.column_stack([9.8 * np.sin(0.3 * t), np.cos(5.0 * t), 9.8 * np.cos(0.3 * t)])
    return rates + rng.normal(0.0, 1e-3, rates.shape), forces + rng.normal(0.0, 1e-2, forces.shape)


def lost(places, most=1, *, sums=(True, True), means=False, seed=0):
    """Return the samples of which some are lost before each place, in sums (or means) or not, and all of them."""
    values = [one.copy() for one in increments(seed)]
    keep = np.ones(COUNT, dtype=bool)
    for k, place in enumerate(places):
        gone = slice(place - 1 - k % most, place)
        keep[gone] = False
        for one, summed in zip(values, sums, strict=True):
            if summed:
                one[place] += one[gone].sum(axis=0)
                one[place] /= 1.0 + means * (1 + k % most)
    stamps = 1_700_000_000_000_000_000 + INTERVAL_NS * np.arange(COUNT)
    file, temperature = Path("imu0/data.csv"), 20.0 + 1e-3 * np.arange(COUNT)
    whole = ImuSamples(stamps, *increments(seed), file, temperature=temperature)
    return ImuSamples(stamps[keep], values[0][keep], values[1][keep], file, temperature=temperature[keep]), whole


@pytest.mark.parametrize(("most", "means"), [(1, False), (4, False), (8, True)])
def test_sums_and_means_stand_for_the_samples_lost_before_them(most, means):
    imu, whole = lost(PLACES, most, means=means)
    found, warnings = with_lost_samples(imu)
    np.testing.assert_array_equal(found.stamps_ns, whole.stamps_ns)
    # nothing is lost: the integrals are those of all samples
    np.testing.assert_allclose(found.rates.sum(axis=0), whole.rates.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.accelerations.sum(axis=0), whole.accelerations.sum(axis=0), atol=1e-9)
    assert np.abs(found.rates - whole.rates).max() < 0.01
    assert np.abs(found.temperature - whole.temperature).max() < 1e-2
    assert len(found.rows) == COUNT
    assert np.all(np.diff(found.rows) >= 0)
    (warning,) = warnings
    assert warning.message.startswith("imu0: 8 rates and accelerations after lost samples, the first at ")
    assert f"line {300 - 1 + 2}, are {'means' if means else 'sums'} over" in warning.message


def test_sums_that_follow_each_other_stand_for_theirs():
    """Before 300 one sample is lost, and the two between it and 303."""
    imu, whole = lost((300, 303, 720, 723, *PLACES[2:]), 3)
    found, (warning,) = with_lost_samples(imu)
    np.testing.assert_array_equal(found.stamps_ns, whole.stamps_ns)
    np.testing.assert_allclose(found.rates.sum(axis=0), whole.rates.sum(axis=0), atol=1e-9)
    assert np.abs(found.rates - whole.rates).max() < 0.01
    assert np.abs(found.accelerations - whole.accelerations).max() < 0.08
    assert "imu0: 10 rates and accelerations" in warning.message


@pytest.mark.parametrize("places", [PLACES, (300, 302, 305, *PLACES[1:])])
def test_sums_show_what_is_lost_where_stamps_only_count(places):
    imu, whole = lost(places)
    counted = replace(imu, stamps_ns=imu.stamps_ns[0] + INTERVAL_NS * np.arange(imu.stamps_ns.size))
    found, (warning,) = with_lost_samples(counted)
    np.testing.assert_array_equal(found.stamps_ns, whole.stamps_ns)
    np.testing.assert_allclose(found.rates.sum(axis=0), whole.rates.sum(axis=0), atol=1e-9)
    assert f"imu0: {len(places)} rates and accelerations" in warning.message


def test_knocks_are_no_sums():
    imu, _ = lost(())
    forces = imu.accelerations.copy()
    knocks = np.random.default_rng(3).normal(0.0, 12.0, (40, 3))
    forces[50:3650:90] += knocks
    knocked = replace(imu, accelerations=forces)
    assert with_lost_samples(knocked) == (knocked, [])


def test_gyros_at_rest_follow_what_accelerometers_show():
    """Their offset is five deviations of their noise."""
    imu, whole = lost(PLACES)
    rng = np.random.default_rng(4)
    rest = rng.normal(5e-3, 1e-3, (COUNT, 3))
    keep = np.isin(whole.stamps_ns, imu.stamps_ns)
    own = rest.copy()
    for place in PLACES:
        own[place] += own[place - 1]
    found, _ = with_lost_samples(replace(imu, rates=own[keep]))
    assert np.abs(found.rates.mean(axis=0) - rest.mean(axis=0)).max() < 2e-6  # 1e-5 with eight rates twice as large


def test_sums_with_the_stamp_of_their_first_sample_come_before_the_lost_ones():
    late, whole = lost([COUNT - 1 - place for place in PLACES], 2)
    stamps = late.stamps_ns
    imu = ImuSamples((stamps[0] + stamps[-1] - stamps)[::-1], late.rates[::-1], late.accelerations[::-1], late.source)
    found, (warning,) = with_lost_samples(imu)
    np.testing.assert_array_equal(found.stamps_ns, whole.stamps_ns)
    np.testing.assert_allclose(found.rates, with_lost_samples(late)[0].rates[::-1])
    assert np.all(np.diff(found.rows) >= 0)
    assert f"before lost samples, the first at line {PLACES[0] + 2}" in warning.message


def test_sums_that_are_cut_off_say_nothing():
    imu, whole = lost(PLACES, 4)
    cut = replace(imu, accelerations=np.clip(imu.accelerations, -28.0, 28.0))
    assert np.any(cut.accelerations != imu.accelerations)
    found, warnings = with_lost_samples(cut)
    assert warnings
    assert np.abs(found.accelerations - whole.accelerations).max() < 0.1  # straight lines over 25 ms


def test_one_sensor_alone_may_keep_its_increments():
    imu, whole = lost(PLACES, sums=(True, False))
    found, (warning,) = with_lost_samples(imu)
    np.testing.assert_allclose(found.rates.sum(axis=0), whole.rates.sum(axis=0), atol=1e-9)
    assert np.abs(found.accelerations - whole.accelerations).max() < 0.06
    assert "8 rates after lost samples" in warning.message


@pytest.mark.parametrize("sums", [(True, True), (False, False)])
def test_readings_that_are_no_sums_and_single_ones_stay(sums):
    imu, _ = lost(PLACES if not any(sums) else (300, 700), sums=sums)
    assert with_lost_samples(imu) == (imu, [])


def test_a_recording_without_lost_samples_stays():
    imu, whole = lost(())
    assert with_lost_samples(imu) == (imu, [])
    assert whole.stamps_ns.size == COUNT


def with_long_steps(places, *, counted, moving=1.0):
    """Return samples with steps of two before some: by a count of rows written twice, or where samples are lost.

    moving: how much of the motion there is; the rest is noise.
    """
    _, whole = lost(())
    noise = [one - other for one, other in zip(increments(1), increments(2), strict=True)]
    if np.ndim(moving):
        rates, forces = moving * whole.rates + noise[0], moving * whole.accelerations + noise[1]
        whole = replace(whole, rates=rates, accelerations=forces)
    stamps, keep = whole.stamps_ns.copy(), np.ones(COUNT, dtype=bool)
    for place in places:
        stamps[place:] += INTERVAL_NS * counted
        keep[place - 1] = counted
    found = ImuSamples(stamps[keep], whole.rates[keep], whole.accelerations[keep], whole.source)
    return found, whole.stamps_ns[keep]


def test_repeats_that_stamps_count_are_taken_out_of_the_stamps():
    imu, right = with_long_steps(PLACES, counted=True)
    found, (warning,) = with_steps_of_one(imu)
    np.testing.assert_array_equal(found.stamps_ns, right)
    assert warning.subject == "stamps"
    assert "after 8 of them, the first at" in warning.message


@pytest.mark.parametrize("places", [PLACES, (300, 700), ()])
def test_stamps_of_samples_that_are_missing_stay(places):
    imu, _ = with_long_steps(places, counted=False)
    assert with_steps_of_one(imu) == (imu, [])


def test_repeats_that_come_evenly_are_of_a_sensor_that_is_asked_too_often():
    imu, _ = with_long_steps(range(300, 3500, 400), counted=True)
    assert with_steps_of_one(imu) == (imu, [])
    assert with_lost_samples(imu) == (imu, [])


def test_two_repeats_say_too_little():
    imu, _ = with_long_steps((300, 700), counted=True)
    assert with_steps_of_one(imu) == (imu, [])


@pytest.mark.parametrize("counted", [True, False])
def test_repeats_show_in_the_moves_between_rests(counted):
    """Most of the time the readings rest, and fit either way."""
    places = np.sort(np.random.default_rng(6).choice(np.arange(40, COUNT - 40, 4), 90, replace=False))
    moving = np.maximum(np.sin(0.8e-9 * INTERVAL_NS * np.arange(COUNT)), 0.0) ** 12
    imu, right = with_long_steps(places.tolist(), counted=counted, moving=moving[:, None])
    found, warnings = with_steps_of_one(imu)
    assert bool(warnings) is counted
    np.testing.assert_array_equal(found.stamps_ns, right)

"""Stamps of regular sampling put back; samples taken unevenly left as they are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples, ReferencePoses
from kreisel.validation.sampling import regularly_sampled, with_lateness

INTERVAL = 5e-3
COUNT = 6000


def signal(t):
    """Return rates of a lively motion, (n, 3)."""
    return np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t + 1.0), np.sin(1.3 * t) * np.cos(4.0 * t)])


def samples(taken, stamped, seed=0, noise=1e-3):
    rng = np.random.default_rng(seed)
    rates = signal(taken) + rng.normal(0.0, noise, (taken.size, 3))
    stamps = 1_700_000_000_000_000_000 + np.round(stamped * 1e9).astype(np.int64)
    return ImuSamples(stamps, rates, np.tile([0.0, 0.0, 9.8], (taken.size, 1)), Path("imu0/data.csv"))


def regular(number=None):
    return INTERVAL * (np.arange(COUNT) if number is None else number)


def assert_recovered(imu, taken, tolerance):
    """The stamps found must be those of sampling, but for one shift of all."""
    off = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9 - (taken - taken[0])
    assert np.ptp(off) < tolerance


def late(seed):
    """Return lateness of a PC, s: 0.3 ms on average, 16 ms one time in two hundred."""
    rng = np.random.default_rng(seed)
    return rng.exponential(3e-4, COUNT) + 16e-3 * (rng.random(COUNT) < 0.005)


def test_even_stamps_stay_as_they_are():
    imu = samples(regular(), regular())
    assert regularly_sampled(imu) == (imu, [])
    gap = np.r_[0:3000, 3002:4000, 4500:COUNT]
    imu = samples(INTERVAL * gap, INTERVAL * gap)
    assert regularly_sampled(imu)[0] is imu


@pytest.mark.parametrize("jitter", [1e-4, 3e-4, 1e-3])
def test_jitter_is_taken_out(jitter):
    stamped = regular() + np.random.default_rng(1).normal(0.0, jitter, COUNT)
    found, (warning,) = regularly_sampled(samples(regular(), stamped))
    assert_recovered(found, regular(), 4.0 * jitter / COUNT**0.5)
    assert "sampled every 5 ms" in str(warning)
    assert f"scatter about that by {1e3 * jitter:.2g} ms" in str(warning)


def test_stamps_of_arrival_are_taken_back_and_the_lateness_is_kept():
    arrival = np.maximum.accumulate(regular() + late(2))
    found, (warning,) = regularly_sampled(samples(regular(), arrival))
    assert_recovered(found, regular(), 5e-5)
    shift = (found.stamps_ns[0] - 1_700_000_000_000_000_000) * 1e-9
    assert 0.0 <= shift < 2.0 * found.lateness
    assert "late" in str(warning)


def test_bursts_are_spread():
    arrival = np.repeat(regular()[3::4], 4) + np.tile([0.0, 1e-4, 2e-4, 3e-4], COUNT // 4)
    found, _ = regularly_sampled(samples(regular(), arrival))
    assert_recovered(found, regular(), 1e-4)
    shift = (found.stamps_ns[0] - 1_700_000_000_000_000_000) * 1e-9
    assert 0.0 < shift < 2.0 * found.lateness


@pytest.mark.parametrize("lateness", [0.0, 1.0])
def test_missing_samples_stay_missing(lateness):
    rng = np.random.default_rng(3)
    number = np.flatnonzero(rng.random(COUNT) > 0.01)
    scatter = lateness * rng.exponential(1e-3, number.size) + rng.normal(0.0, 1e-4, number.size)
    stamped = np.maximum.accumulate(INTERVAL * number + scatter) + 1e-8 * np.arange(number.size)
    found, (warning,) = regularly_sampled(samples(INTERVAL * number, stamped))
    off = (found.stamps_ns - found.stamps_ns[0]) * 1e-9 - INTERVAL * (number - number[0])
    assert np.mean(np.abs(off - np.median(off)) < 0.02 * INTERVAL) > 0.99
    assert "missing" in str(warning)


def test_rounding_is_taken_out():
    found, _ = regularly_sampled(samples(regular(), np.round(regular() + 2.2e-4, 3)))
    assert found.stamps_ns.size == COUNT  # every fifth millisecond: even already
    fast = 2.5e-3 * np.arange(COUNT)
    found, _ = regularly_sampled(samples(fast, np.round(fast, 3)))
    assert_recovered(found, fast, 1e-5)


def test_a_long_gap_divides_the_line():
    number = np.r_[0:3000, 3400:COUNT]
    taken = INTERVAL * number + np.where(number > 3000, 1.7e-3, 0.0)  # the timer began anew
    stamped = taken + np.random.default_rng(4).normal(0.0, 2e-4, number.size)
    found, _ = regularly_sampled(samples(taken, stamped))
    assert_recovered(found, taken, 1e-4)


def queued(stamped, held, seed):
    """Return stamps at the end of a queue that sends four times as fast, held up at some moments, s (m, 2)."""
    arrival, last = np.empty(stamped.size), -1.0
    service = np.random.default_rng(seed).exponential(INTERVAL / 4.0, stamped.size)
    for k, moment in enumerate(stamped):
        ready = max(moment, last)
        for begin, seconds in held:
            ready = begin + seconds if begin <= ready < begin + seconds else ready
        last = arrival[k] = ready + service[k]
    return arrival


@pytest.mark.parametrize("begin", [0.5, 10.0, 29.2])
def test_a_queue_that_is_held_up_has_lost_nothing(begin):
    arrival = queued(regular(), [(begin, 0.2), (12.0, 0.09)], seed=6)
    found, (warning,) = regularly_sampled(samples(regular(), arrival))
    assert_recovered(found, regular(), 5e-5)
    assert "missing" not in str(warning)


@pytest.mark.parametrize("place", [150, 3000, COUNT - 150])
@pytest.mark.parametrize("missing", [1, 20])
def test_samples_that_a_queue_loses_stay_missing(place, missing):
    number = np.r_[0:place, place + missing : COUNT]
    arrival = queued(regular(number), [(INTERVAL * place, 0.2)], seed=7)
    found, _ = regularly_sampled(samples(regular(number), arrival))
    step = np.diff(found.stamps_ns)[place - 2 : place + 2].sum() * 1e-9
    assert step > (3.0 + 0.5 * missing) * INTERVAL


def test_samples_that_were_taken_unevenly_are_left():
    """A program that asks the sensor when it comes round to it, and stamps what it gets: the stamps are true."""
    taken = regular() + np.random.default_rng(5).normal(0.0, 5e-4, COUNT)
    imu = samples(taken, taken)
    assert regularly_sampled(imu) == (imu, [])


def test_a_clock_that_wanders_is_no_straight_line():
    t = regular()
    stamped = t + 5e-3 * np.sin(2.0 * np.pi * t / 20.0) + np.random.default_rng(6).normal(0.0, 1e-4, COUNT)
    imu = samples(t, stamped)
    assert regularly_sampled(imu) == (imu, [])


def test_rows_written_twice_are_not_mended():
    imu = samples(regular(), regular())
    twice = np.sort(np.r_[np.arange(COUNT), np.arange(100, 200)])
    imu = replace(imu, stamps_ns=imu.stamps_ns[twice], rates=imu.rates[twice], accelerations=imu.accelerations[twice])
    assert regularly_sampled(imu) == (imu, [])


@pytest.mark.parametrize("count", [0, 1, 50, 99])
def test_a_few_samples_are_left_alone(count):
    imu = samples(regular()[:count], regular()[:count])
    assert regularly_sampled(imu) == (imu, [])


def poses(stamps_ns):
    return ReferencePoses("pose0", np.asarray(stamps_ns), None, None, Path("pose0/data.csv"))


def test_rounded_stamps_of_poses_are_told_and_their_rounding_is_kept():
    even = 12_000_000 * np.arange(2000) + 3_700_000
    kept, said = with_lateness(poses(10_000_000 * np.round(even / 10_000_000).astype(np.int64)))
    assert kept.lateness == pytest.approx(10e-3 / 12**0.5, rel=0.1)
    assert "stamps are rounded to 10 ms" in said[0].message


@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_stamps_of_poses_that_are_exact_have_no_lateness(lost):
    keep = np.random.default_rng(3).random(2000) >= lost
    kept, said = with_lateness(poses((10_000_000 * np.arange(2000))[keep]))
    assert kept.lateness == 0.0
    assert said == []


@pytest.mark.parametrize(
    ("rate", "asked", "repeats"), [(187.3, 200.0, False), (104.0, 200.0, False), (199.9, 200.0, True)]
)
def test_a_sensor_that_is_asked_more_often_than_it_measures_has_lost_nothing(rate, asked, repeats):
    """Stamps are those of the asking: steps of 5 ms, and sometimes of 10 ms."""
    taken = np.arange(round(60.0 * rate) if rate < 199.0 else 40_000) / rate
    stamped = np.ceil(asked * taken + 0.3) / asked
    found, (warning,) = regularly_sampled(samples(taken, stamped), repeats=repeats)
    assert_recovered(found, taken, 3e-4)
    assert "missing" not in str(warning)
    assert 0.2 / asked < found.lateness < 0.35 / asked


def test_samples_that_are_lost_evenly_stay_lost():
    number = np.flatnonzero(np.arange(COUNT) % 15 != 7)
    imu = samples(INTERVAL * number, INTERVAL * number, noise=1e-5)
    assert regularly_sampled(imu)[0] is imu


def test_samples_that_are_lost_at_random_stay_lost():
    for seed in range(20):
        lost = np.random.default_rng(seed).choice(COUNT, 12, replace=False)
        number = np.setdiff1d(np.arange(COUNT), lost)
        imu = samples(INTERVAL * number, INTERVAL * number)
        assert regularly_sampled(imu, repeats=True)[0] is imu


def test_stamps_in_whole_seconds_show_no_asking():
    imu = samples(regular(), np.floor(regular()))
    assert regularly_sampled(imu)[0] is imu

"""Increments that were divided by another interval than the one they were taken over."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples
from kreisel.validation.interval_readings import with_own_intervals

INTERVAL, COUNT = 5e-3, 4000
FILE = Path("imu0/data.csv")


def turned(t):
    """Return the integrals of rates and forces (n, 3) of a lively motion."""
    rates = [-np.cos(3.0 * t) / 3.0, np.sin(2.0 * t + 1.0) / 2.0, np.sin(4.0 * t) / 4.0]
    forces = [-9.8 * np.cos(0.3 * t) / 0.3, np.sin(5.0 * t) / 5.0, 9.8 * np.sin(0.3 * t) / 0.3]
    return np.column_stack(rates), np.column_stack(forces)


def at(stamped):
    return 1_700_000_000_000_000_000 + np.round(stamped * 1e9).astype(np.int64)


def increments(taken, divided, stamped, seed=0):
    """Return increments between moments of sampling (n + 1,), divided by intervals (n,), with stamps (n,)."""
    rng = np.random.default_rng(seed)
    values = [
        np.diff(own, axis=0) / np.broadcast_to(divided, taken.size - 1)[:, None]
        + rng.normal(0.0, noise, (taken.size - 1, 3))
        for own, noise in zip(turned(taken), (1e-3, 1e-2), strict=True)
    ]
    return ImuSamples(at(stamped), *values, FILE)


def even():
    return INTERVAL * np.arange(COUNT + 1)


def two_timers():
    return even() + 0.2 * INTERVAL * (np.arange(COUNT + 1) % 2)


def wandering():
    return even() + 0.1 / (6.0 * np.pi) * np.sin(6.0 * np.pi * even())


def right(imu, taken):
    """Return errors of rates and forces against the means over the intervals they were taken over, less a shift."""
    found = (imu.rates, imu.accelerations)
    return [
        float(np.sqrt(np.mean((one - np.diff(own, axis=0) / np.diff(taken)[:, None])[1:] ** 2)))
        for one, own in zip(found, turned(taken), strict=True)
    ]


@pytest.mark.parametrize("taken", [two_timers(), wandering()], ids=["two timers", "wandering"])
def test_increments_over_the_nominal_interval_are_divided_by_their_own(taken):
    imu = increments(taken, INTERVAL, taken[1:])
    assert right(imu, taken)[1] > 0.2
    found, (warning,) = with_own_intervals(imu)
    rates, forces = right(found, taken)
    assert rates < 1.3e-3
    assert forces < 1.3e-2
    # readings are now in the middle of their intervals, but for half a nominal one
    middle = 0.5 * (taken[1:] + taken[:-1]) + 0.5 * INTERVAL
    np.testing.assert_allclose(1e-9 * (found.stamps_ns - at(middle))[1:], 0.0, atol=2e-6)
    assert "rates and accelerations are increments that were divided by the nominal interval" in warning.message


def test_counters_divided_by_differences_of_arrival_are_rates_over_even_intervals():
    arrived = even() + np.abs(np.random.default_rng(3).normal(0.0, 0.06 * INTERVAL, COUNT + 1))
    imu = increments(even(), np.diff(arrived), arrived[1:])
    assert right(imu, even())[1] > 0.2
    found, (warning,) = with_own_intervals(imu)
    rates, forces = right(found, even())
    assert rates < 1.3e-3
    assert forces < 1.3e-2
    np.testing.assert_array_equal(found.stamps_ns, imu.stamps_ns)
    assert "differences of stamps that are not the moments of sampling" in warning.message


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.2])
def test_rates_with_stamps_that_scatter_stay(scatter):
    """Taken evenly and stamped late, and taken when stamped."""
    late = even() + scatter * INTERVAL * np.abs(np.random.default_rng(4).normal(size=COUNT + 1))
    for taken in (even(), late):
        imu = increments(taken, np.diff(taken), late[1:])
        assert with_own_intervals(imu) == (imu, [])


def test_the_nominal_interval_is_that_of_most_samples():
    """Some increments are taken in two halves: the mean interval is 0.5 % shorter than the nominal one."""
    taken = np.sort(np.concatenate([even(), even()[100:-100:200] + 0.5 * INTERVAL]))
    imu = increments(taken, INTERVAL, taken[1:])
    found, _ = with_own_intervals(imu)
    halved = np.diff(taken) < 0.9 * INTERVAL
    np.testing.assert_array_equal(found.rates[~halved], imu.rates[~halved])
    np.testing.assert_allclose(found.rates[halved], 2.0 * imu.rates[halved], rtol=1e-6)


def test_one_sensor_alone_may_give_increments():
    taken = two_timers()
    imu = increments(taken, INTERVAL, taken[1:])
    mixed = replace(imu, rates=increments(taken, np.diff(taken), taken[1:]).rates)
    found, (warning,) = with_own_intervals(mixed)
    np.testing.assert_array_equal(found.rates, mixed.rates)
    assert "accelerations are increments" in warning.message
    assert "rates and" not in warning.message


def test_missing_samples_and_stamps_that_do_not_ascend_are_left_to_others():
    taken = two_timers()
    imu = increments(taken, INTERVAL, taken[1:])
    keep = np.ones(COUNT, dtype=bool)
    keep[[500, 1200, 1201, 3000]] = False
    part = ImuSamples(imu.stamps_ns[keep], imu.rates[keep], imu.accelerations[keep], FILE)
    found, warnings = with_own_intervals(part)
    whole, _ = with_own_intervals(imu)
    assert warnings
    after = np.flatnonzero(np.diff(part.stamps_ns) > 1.8 * INTERVAL * 1e9) + 1
    np.testing.assert_array_equal(found.rates[after], part.rates[after])
    same = np.setdiff1d(np.arange(1, keep.sum()), after)
    np.testing.assert_allclose(found.rates[same], whole.rates[keep][same], rtol=1e-3)
    back = part.stamps_ns.copy()
    back[700] = back[699]
    back[900] = back[898]
    with_own_intervals(replace(part, stamps_ns=back))
    few = ImuSamples(back[:5], part.rates[:5], part.accelerations[:5], FILE)
    assert with_own_intervals(few) == (few, [])

"""IMUs of an array that turn, or whose clock jumps, in a recording; and such that do not."""

import numpy as np
import pytest

from kreisel.array.sudden_change import sudden_change
from kreisel.geometry.rotation import exp, matrix

RATE, SECONDS = 50.0, 120.0
T = np.arange(round(RATE * SECONDS)) / RATE
AT = 40.0


def waves(rng):
    """Return rates (n, 3) of turns by hand and of shaking that begins at 80 s, and their derivative."""
    rates, slope = np.zeros((T.size, 3)), np.zeros((T.size, 3))
    for size, frequency, begin in ((1.5, 0.4, 0.0), (12.0, 3.0, 80.0)):
        for _ in range(4):
            f, phase, own = frequency * rng.uniform(0.7, 1.3), rng.uniform(0.0, 6.0, 3), size * rng.normal(size=3) / 2.0
            rates += (begin <= T)[:, None] * own * np.sin(2.0 * np.pi * f * T[:, None] + phase)
            slope += (begin <= T)[:, None] * own * 2.0 * np.pi * f * np.cos(2.0 * np.pi * f * T[:, None] + phase)
    return rates, slope


def units(count, seed=1, bent=0.0):
    rng = np.random.default_rng(seed)
    rates, slope = waves(rng)
    out = np.array([rates @ (np.eye(3) + 1e-2 * rng.normal(size=(3, 3))) for _ in range(count)])
    for one in out:
        one += bent * rng.normal(size=3) * one**3 + 5e-3 * rng.normal(size=one.shape)
    return out, slope


def turned(rates, k, angle=5e-3, at=AT):
    rates[k] = np.where((at < T)[:, None], rates[k] @ matrix(exp(angle * np.array([0.6, -0.64, 0.48]))), rates[k])


@pytest.mark.parametrize("count", [2, 3, 8])
@pytest.mark.parametrize("bent", [0.0, 2e-5])
def test_units_that_do_not_change_are_not_accused(count, bent):
    """Neither if gyros of a third degree read 3 mrad less when shaken."""
    rates, slope = units(count, bent=bent)
    assert sudden_change(T, rates, slope) is None


@pytest.mark.parametrize(("count", "number"), [(2, 1), (3, 0), (4, 2), (8, 7)])
@pytest.mark.parametrize("at", [AT, 100.0])
def test_a_unit_that_turns_is_named(count, number, at):
    rates, slope = units(count)
    turned(rates, number, angle=8e-3, at=at)
    found = sudden_change(T, rates, slope)
    assert (found.number, found.turn) == (number, True)
    assert found.size == pytest.approx(8e-3, rel=0.15)
    assert found.seconds == pytest.approx(at, abs=2.5)
    assert "turns against the others by " in found.text


def attitudes(count):
    """Return rates of turns by hand about one axis after the other, with pauses, and their derivative."""
    rng = np.random.default_rng(4)
    rates, slope = np.zeros((T.size, 3)), np.zeros((T.size, 3))
    for begin in np.arange(2.0, SECONDS - 4.0, 4.0):
        size = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
        inside = (begin <= T) & (begin + 2.0 > T)
        rates[inside] += np.sin(0.5 * np.pi * (T[inside] - begin))[:, None] ** 2 * size
        slope[inside] += 0.5 * np.pi * np.sin(np.pi * (T[inside] - begin))[:, None] * size
    return np.array([rates @ (np.eye(3) + 1e-2 * rng.normal(size=(3, 3))) for _ in range(count)]), slope


@pytest.mark.parametrize(("count", "number"), [(2, 1), (4, 2)])
def test_a_unit_that_turns_between_attitudes_is_named(count, number):
    """A turn by hand shows no rotation about its own axis: parts with one turn do not show one alone."""
    rates, slope = attitudes(count)
    rates += 1e-3 * np.random.default_rng(5).normal(size=rates.shape)
    assert sudden_change(T, rates, slope) is None
    turned(rates, number, angle=2e-2)
    found = sudden_change(T, rates, slope)
    assert (found.number, found.turn) == (number, True)
    assert found.size == pytest.approx(2e-2, rel=0.2)


def test_offsets_that_drift_and_spikes_are_no_turn():
    rates, slope = attitudes(3)
    rates += 1e-3 * np.random.default_rng(6).normal(size=rates.shape)
    rates[1] += 0.02 * (1.0 - np.exp(-T / 60.0))[:, None]
    rates[2, ::97, 0] += 3.0
    assert sudden_change(T, rates, slope) is None


@pytest.mark.parametrize(("count", "number"), [(2, 1), (4, 0)])
def test_a_clock_that_jumps_is_named(count, number):
    rates, slope = units(count)
    rates[number] += (T > AT)[:, None] * 4e-3 * slope
    found = sudden_change(T, rates, slope)
    assert (found.number, found.turn) == (number, False)
    assert found.size == pytest.approx(4e-3, rel=0.3)
    assert "its clock jumps by" in found.text


def test_two_that_turn_alike_accuse_nobody():
    """Of four units two turned, or the other two did."""
    rates, slope = units(4)
    turned(rates, 0)
    turned(rates, 1)
    assert sudden_change(T, rates, slope) is None


def test_small_changes_are_left_alone():
    rates, slope = units(4)
    turned(rates, 2, angle=1e-3)
    assert sudden_change(T, rates, slope) is None

"""Turns whose slow ends a device sets to zero: what is restored, against the whole turns."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples
from kreisel.static.slow_ends import UNSURE, with_slow_ends

STEP = 0.01


def turns(shape, angle=1.5, seconds=2.0, count=6):
    """Return rates (n, 3) of turns with rests of a second between them."""
    s = np.linspace(0.0, 1.0, round(seconds / STEP))
    course = shape(s)
    turn = angle * course / (course.sum() * STEP)
    rests = np.zeros(round(1.0 / STEP))
    axes = np.random.default_rng(1).normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.vstack([np.outer(np.concatenate([rests, turn]), axis) for axis in axes] + [np.zeros((100, 3))])


def imu(rates):
    stamps = np.round(1e9 * STEP * np.arange(len(rates))).astype(np.int64)
    return ImuSamples(stamps, rates, np.tile([0.0, 0.0, 9.8], (len(rates), 1)), Path("imu0/data.csv"))


@pytest.mark.parametrize(
    "shape", [lambda s: s**2 * (1.0 - s) ** 2, lambda s: np.minimum(s, 1.0 - s), lambda s: np.sin(np.pi * s)]
)
@pytest.mark.parametrize("limit", [0.1, 0.2])
def test_turns_have_their_whole_angle_but_for_a_third_of_what_was_lacking(shape, limit):
    whole = turns(shape)
    read = np.where(np.linalg.norm(whole, axis=1, keepdims=True) < limit, 0.0, whole)
    found, share = with_slow_ends(imu(read))
    angle, by, after = (STEP * np.linalg.norm(rates, axis=1).sum() for rates in (whole, read, found.rates))
    assert abs(after - angle) < UNSURE * (angle - by)
    assert share == pytest.approx(angle / by - 1.0, rel=UNSURE)


def test_readings_without_zeros_are_as_they_were():
    rates = turns(np.sqrt) + 1e-3
    found, share = with_slow_ends(imu(rates))
    assert share == 0.0
    np.testing.assert_array_equal(found.rates, rates)

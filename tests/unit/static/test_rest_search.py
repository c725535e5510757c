"""Standstills are found whole, with their noise; what moves within is none."""

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.inertial.noise_figures import GRADES
from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.rest_search import MARGIN, find_rests
from kreisel.static.rests import Rests
from kreisel.validation.checks import check_streams


def test_standstills_and_their_noise():
    _, recording = hand_turned(HandTurns(attitudes=10), np.random.default_rng(1))
    rests = find_rests(check_streams(recording).imu)
    assert isinstance(rests, Rests)
    assert rests.count == 10
    assert np.all(rests.durations > 2.8 - 2.0 * MARGIN - 0.25)
    assert np.all(rests.first[1:] > rests.last[:-1])
    grade = GRADES["consumer-mems"]
    np.testing.assert_allclose(rests.density_a, grade.accel_noise_density, rtol=0.25)
    np.testing.assert_allclose(rests.density_w, grade.gyro_noise_density, rtol=0.35)
    half = rests.part(np.arange(5))
    assert half.count == 5
    assert half.density_w is rests.density_w


def test_a_recording_that_never_rests_has_no_standstill():
    _, recording = hand_turned(HandTurns(attitudes=10, tremor=0.03), np.random.default_rng(2))
    with pytest.raises(RecordingError, match="no standstill is found: lay the device down"):
        find_rests(check_streams(recording).imu)

"""Readings that a device truncates to zero, against the same before it does."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams

FINE, COARSE = (1.7e-3, 0.01), (0.0175, 0.04)
"""rad/s and m/s^2: steps of 0.1 and 1 deg/s, and of 1 and 4 mg."""


@pytest.fixture(scope="module")
def whole():
    return hand_turned(HandTurns("industrial-mems", attitudes=24, rest=3.0), np.random.default_rng(3))[1]


@pytest.fixture(scope="module")
def from_whole(whole):
    return calibrate_static(check_streams(whole)).calibration


def in_steps(recording, to, sizes):
    imu = recording.imu
    rates, forces = (to(x / step) * step for x, step in zip((imu.rates, imu.accelerations), sizes, strict=True))
    return check_streams(replace(recording, imu=replace(imu, rates=rates, accelerations=forces)))


def worst(outcome, from_whole):
    """Return the largest difference of a matrix or an offset from that by whole readings, in deviations."""
    found, sd = outcome.calibration.sensors, outcome.calibration.sensor_sd
    scores = [
        np.abs(getattr(found, name) - getattr(from_whole.sensors, name)) / np.where(own > 0.0, own, np.inf)
        for name, own in (("K_omega", sd.K_omega), ("k_w", sd.k_w), ("K_a", sd.K_a), ("k_a", sd.k_a))
    ]
    return float(max(one.max() for one in scores))


def truncates(outcome):
    return any("truncates its readings to zero" in one.message for one in outcome.warnings)


@pytest.mark.parametrize("sizes", [FINE, COARSE], ids=["0.1 deg/s, 1 mg", "1 deg/s, 4 mg"])
def test_half_a_step_of_truncated_readings_is_restored(whole, from_whole, sizes):
    outcome = calibrate_static(in_steps(whole, np.trunc, sizes))
    assert truncates(outcome)
    assert worst(outcome, from_whole) < 3.0


@pytest.mark.parametrize("sizes", [FINE, COARSE], ids=["0.1 deg/s, 1 mg", "1 deg/s, 4 mg"])
def test_rounded_readings_are_left_alone(whole, from_whole, sizes):
    outcome = calibrate_static(in_steps(whole, np.round, sizes))
    assert not truncates(outcome)
    assert worst(outcome, from_whole) < 3.0


def test_readings_that_a_device_floors_have_other_offsets_alone(whole, from_whole):
    outcome = calibrate_static(in_steps(whole, lambda x: np.floor(x) + 0.5, FINE))
    assert not truncates(outcome)
    assert worst(outcome, from_whole) < 3.0

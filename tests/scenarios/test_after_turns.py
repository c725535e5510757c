"""Devices that relax after every turn, and gyros that settle: what is put into standstills is taken out, or named."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.simulation.standstills import HandTurns, hand_turned
from kreisel.static.after_turns import after_turn
from kreisel.static.rest_search import find_rests
from kreisel.static.static_result import calibrate_static
from kreisel.validation.checks import check_streams

from .test_standstills import scores

HOW = HandTurns("industrial-mems", attitudes=30, laid="hinge", table_axis=(0.96, 0.28, 0.05), rest=4.0)


def relaxing(recording, angle, tau, *, device=True):
    """Return readings of a device, or of its gyros alone, that turns back by an angle after each turn.

    It is undone within a tenth of a second when the next turn begins.
    """
    imu, rests = recording.imu, find_rests(recording.imu)
    h, rates, forces = imu.interval, imu.rates.copy(), imu.accelerations.copy()
    sums = np.cumsum(imu.rates - rests.rates.mean(axis=0), axis=0) * h
    for k in range(1, rests.count):
        way = sums[rests.first[k]] - sums[rests.last[k - 1]]
        n = way / np.linalg.norm(way)
        a, b = rests.first[k] - round(0.1 / h), rests.last[k]
        gone = -angle * (1.0 - np.exp(-np.arange(b - a) * h / tau))
        rates[a:b] += np.gradient(gone, h)[:, None] * n
        if device:
            forces[a:b] -= gone[:, None] * np.cross(n, imu.accelerations[a:b])
            rates[b : b + round(0.1 / h)] -= gone[-1] * n / 0.1
    return replace(recording, imu=replace(imu, rates=rates, accelerations=forces))


@pytest.mark.parametrize(
    ("angle", "tau"), [(2e-3, 1.5), pytest.param(4e-3, 3.0, marks=pytest.mark.slow)], ids=["1.5 s", "3 s"]
)
def test_a_device_that_relaxes_after_each_turn(angle, tau):
    """All scale factors of the gyros had been ten deviations off, without a word."""
    truth, recording = hand_turned(HOW, np.random.default_rng([1, 84]))
    outcome = calibrate_static(check_streams(relaxing(recording, angle, tau)))
    assert any("goes on turning for a while at standstills" in one.message for one in outcome.warnings)
    assert outcome.calibration.accepted, outcome.calibration.verdict
    assert np.abs(scores(truth, outcome)).max() < 4.0


def test_gyros_that_settle_after_each_turn_are_named():
    _, recording = hand_turned(HOW, np.random.default_rng([2, 84]))
    verdict = calibrate_static(check_streams(relaxing(recording, 2e-3, 1.5, device=False))).calibration.verdict
    assert any("gravity shows that the device stands still: it zeroes them by itself" in r for r in verdict.reasons)
    assert verdict.sensors == {"gyroscope": "rejected", "accelerometer": "accepted"}


def test_a_device_that_stands_still_shows_nothing():
    for seed in range(3):
        imu = hand_turned(replace(HOW, rest=2.0), np.random.default_rng([seed, 85]))[1].imu
        assert after_turn(imu, find_rests(imu)) is None

"""Samples lost at even intervals: found at rest, too, where those that show lie on a comb."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.synchronization.clock import Clock
from kreisel.synchronization.even_losses import evenly_lost
from kreisel.synchronization.lost_samples import LostSamples
from kreisel.validation.checks import check_streams

INTERVAL = 5_000_000
CLOCK = Clock(0.7, 2e-5)
FAULTLESS = dict.fromkeys(
    (f"{kind}_{of}_sd" for kind in ("repeatability", "path") for of in ("position", "orientation")), 0.0
)


def found_at(seconds, width=0.1):
    """Return losses found at IMU seconds, by a reference on another clock."""
    seconds = np.asarray(seconds)
    tau = CLOCK.reference_time(seconds)
    places = np.round(seconds * 1e9 / INTERVAL).astype(np.int64)
    return LostSamples(places, np.ones_like(places), INTERVAL, np.column_stack([tau - 0.5 * width, tau + 0.5 * width]))


def stamps(seconds=240.0):
    return INTERVAL * np.arange(round(seconds * 1e9 / INTERVAL), dtype=np.int64)


@pytest.mark.parametrize("period", [8.0, 16.5, 31.3])
def test_all_teeth_are_there_if_some_were_found(period):
    rng = np.random.default_rng(round(period))
    teeth = np.arange(0.4 * period, 240.0, period)
    seen = np.sort(rng.choice(teeth.size, max(5, teeth.size // 3), replace=False))
    combs = evenly_lost(found_at(teeth[seen] + rng.uniform(-0.04, 0.04, seen.size)), stamps(), CLOCK)
    comb = min(combs, key=lambda one: abs(one.faster - 5e-3 / period))
    assert comb.places.size == teeth.size
    np.testing.assert_allclose(comb.places * 1e-9 * INTERVAL, teeth, atol=0.15)
    assert comb.faster == pytest.approx(5e-3 / period, rel=5e-3)
    tau = CLOCK.reference_time(teeth)
    assert ((comb.unsure[:, 0] < tau) & (tau < comb.unsure[:, 1])).all()


def test_one_place_that_is_wrong_does_not_matter():
    teeth = np.arange(6.0, 240.0, 16.667)[[0, 2, 3, 5, 8, 9, 12]]
    teeth[3] += 2.5
    combs = evenly_lost(found_at(teeth), stamps(), CLOCK)
    assert any(one.faster == pytest.approx(3e-4, rel=5e-3) for one in combs)


@pytest.mark.parametrize("seconds", [[20.0, 60.0], [11.0, 43.0, 60.0, 81.0, 119.0, 153.0, 171.0, 226.0]])
def test_few_losses_and_those_at_random_lie_on_no_comb(seconds):
    assert evenly_lost(found_at(seconds), stamps(), CLOCK) == []


@cache
def polled(measured_hz):
    """Return a recording of a sensor that measures at a rate, asked at 200 Hz."""
    cell = {"seed": 4, "seconds": 150.0, "motion": {"rest": 0.3}, "reference": {"joints": False}, "errors": FAULTLESS,
            "imu": {"grade": "industrial-mems", "rate": measured_hz}}  # fmt: skip
    r = simulate(Cell.model_validate(cell), Path("run"))[1]
    first = int(r.imu.stamps_ns[0])
    asked = first + INTERVAL * np.arange(1, (int(r.imu.stamps_ns[-1]) - first) // INTERVAL, dtype=np.int64)
    newest = np.searchsorted(r.imu.stamps_ns, asked, side="right") - 1
    imu = replace(r.imu, stamps_ns=asked, rates=r.imu.rates[newest], accelerations=r.imu.accelerations[newest])
    return check_streams(replace(r, imu=imu)), r.imu.stamps_ns[newest]


def test_a_sensor_that_measures_a_little_faster_than_it_is_asked_is_put_right():
    recording, true = polled(200.1)
    found = prepare_recording(recording, CalibrationSettings())
    (said,) = [w.message for w in found.warnings if "faster than its readings are asked for" in w.message]
    assert "0.05 % faster" in said
    assert "one every 10 s" in said
    off = (found.recording.imu.stamps_ns - true).astype(float)
    wrong = np.abs(off - np.median(off)) > 0.3 * INTERVAL
    assert np.mean(wrong) < 0.1
    before = (recording.imu.stamps_ns - true).astype(float)
    assert np.std(off) < 0.4 * np.std(before)
    assert found.recording.imu.lateness == pytest.approx(5e-3 * 12**-0.5, rel=0.1)


def test_losses_about_one_moment_are_on_no_comb():
    assert evenly_lost(found_at([100.0, 100.01, 100.02, 100.03, 100.04, 100.05]), stamps(), CLOCK) == []

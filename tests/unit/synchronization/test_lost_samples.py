"""Samples lost from counted stamps: found where they are, and nowhere else."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import SynchronizationError
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation import clock_stages
from kreisel.preparation.comparison import compare
from kreisel.preparation.plausibility import check_start_values
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import Cell
from kreisel.study.situations import random_situation
from kreisel.synchronization.lost_samples import LostSamples
from kreisel.tasks import sequential
from kreisel.validation.checks import check_streams

SECONDS, INTERVAL = 60.0, 5_000_000


@cache
def complete():
    """Return a recording of 200 Hz in which nothing is lost."""
    cell = {"seed": 4, "seconds": SECONDS, "imu": {"grade": "industrial-mems"}, "reference": {"joints": False}}
    return simulate(Cell.model_validate(cell), Path("run"))[1]


def without(lost, counted=True):
    """Return the recording without some samples; stamps are counted, or true."""
    r = complete()
    keep = np.ones(r.imu.stamps_ns.size, dtype=bool)
    keep[lost] = False
    stamps = r.imu.stamps_ns[: keep.sum()] if counted else r.imu.stamps_ns[keep]
    imu = replace(r.imu, stamps_ns=stamps, rates=r.imu.rates[keep], accelerations=r.imu.accelerations[keep])
    return check_streams(replace(r, imu=imu)), r.imu.stamps_ns[keep]


def prepared(recording):
    return prepare_recording(recording, CalibrationSettings())


def told(preparation):
    return [w.message for w in preparation.warnings if "lost without a gap" in w.message]


@pytest.mark.parametrize("lost", [[3000, 3001, 3002], [2500, 5200, 7100, 9000]])
def test_a_few_are_found_near_their_places(lost):
    broken, true = without(lost)
    found = prepared(broken)
    (message,) = told(found)
    assert f"but {len(lost)} sample" in message
    assert "counted every 5 ms" in message
    off = found.recording.imu.stamps_ns - true
    off -= off[0]
    assert set(np.unique(off)) <= {-k * INTERVAL for k in range(-3, 4)}
    moving = np.linalg.norm(found.recording.imu.rates, axis=1) > 0.3
    assert np.mean(off[moving] != 0) < 0.06
    assert off[-1] == 0
    # where the filter uses poses, stamps are right
    t = found.rate_fit.clock.imu_time(found.reference.seconds)
    k = np.clip(np.searchsorted(found.recording.imu.seconds, t), 0, off.size - 1)
    assert np.mean(off[k[~found.reference.doubtful & moving[k]]] != 0) < 0.02
    assert np.mean(found.reference.doubtful) < 0.2


def test_nothing_is_found_where_nothing_is_lost():
    found = prepared(without([])[0])
    assert told(found) == []
    assert found.reference.doubtful is None


def test_what_may_lie_anywhere_is_a_ratio_of_the_clocks():
    """Gyros err by a degree per second: six lost samples had been found, of which no place was sure."""
    situation = random_situation(78693)
    recording = simulate(Cell.model_validate({**situation.cell, "seed": 78693}), Path("run"))[1]
    found = prepared(check_streams(recording))
    assert told(found) == []
    assert found.reference.doubtful is None


def test_samples_that_leave_a_gap_are_no_such_case():
    broken, true = without([2500, 5200, 7100, 9000], counted=False)
    found = prepared(broken)
    assert told(found) == []
    np.testing.assert_array_equal(found.recording.imu.stamps_ns, true)


def test_a_clock_that_is_slower_has_lost_nothing():
    r = complete()
    stamps = r.imu.stamps_ns[0] + np.round((r.imu.stamps_ns - r.imu.stamps_ns[0]) * (1.0 - 250e-6)).astype(np.int64)
    found = prepared(check_streams(replace(r, imu=replace(r.imu, stamps_ns=stamps))))
    assert told(found) == []
    assert found.rate_fit.clock.skew == pytest.approx(-250e-6, abs=2e-5)


@pytest.mark.slow
def test_too_many_are_left_as_they_are():
    """It cannot be found out where: the check of the clocks refuses the recording."""
    rng = np.random.default_rng(2)
    lost = np.flatnonzero(rng.random(complete().imu.stamps_ns.size) < 0.02)
    found = prepared(without(lost[lost > 1])[0])
    assert told(found) == []
    with pytest.raises(SynchronizationError, match="clocks"):
        check_start_values(found)


def test_a_clock_that_jumps_has_lost_nothing():
    r = complete()
    poses = r.reference
    jumped = poses.stamps_ns + 15_000_000 * (poses.seconds > 31.0)
    assert told(prepared(check_streams(replace(r, reference=replace(poses, stamps_ns=jumped))))) == []


def test_losses_by_which_the_rates_fit_worse_are_none(monkeypatch):
    """A search that names places where nothing was lost: the ratio of the clocks gets farther from one by them."""
    before = compare(check_streams(complete()), complete().reference, sequential)
    places = np.array([2500, 5200, 7100, 9000])
    seconds = before.recording.imu.seconds[places]
    false = LostSamples(places, np.ones(4, dtype=np.int64), INTERVAL, np.column_stack([seconds - 0.5, seconds + 0.5]))
    first = before.recording.imu
    monkeypatch.setattr(clock_stages, "find_lost_samples", lambda imu, *_: false if imu is first else None)
    worse = before.of(replace(before.recording, imu=false.restored(before.recording.imu)))
    assert worse.fit.residual_sd > before.fit.residual_sd
    assert clock_stages.without_losses(before) is None

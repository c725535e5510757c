"""Poses with stamps of arrival, in bursts or late by chance: those of regular sampling, or a message."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.recording.recording import ReferencePoses
from kreisel.validation.sampling import evenly_stamped

STEP = 8_000_000


def poses(stamps: np.ndarray) -> ReferencePoses:
    return ReferencePoses("pose0", stamps, np.zeros((stamps.size, 3)), None, Path("run") / "pose0" / "data.csv")


def arrived(count: int, at_once: int, gap: int = 60_000) -> np.ndarray:
    """Return stamps of a device that sends several poses at once, with a delay that scatters."""
    number = np.arange(count)
    last = STEP * (number // at_once * at_once + at_once - 1)
    delay = np.random.default_rng(1).integers(0, 700_000, count // at_once + 1)[number // at_once]
    return 10**12 + last + delay + gap * (number % at_once)


@pytest.mark.parametrize(("at_once", "gap"), [(2, 60_000), (3, 60_000), (4, 60_000), (7, 60_000), (4, 0)])
def test_poses_that_come_several_at_once_are_even_again(at_once, gap):
    """Also several with one stamp."""
    reference = poses(arrived(4000, at_once, gap))
    found, (warning,) = evenly_stamped(reference)
    steps = np.diff(found.stamps_ns)
    assert np.abs(steps - STEP).max() < 2_000
    assert "come in bursts" in warning.message
    assert found.lateness == pytest.approx(1e-9 * STEP * np.std(np.arange(at_once)), rel=0.2)


def test_poses_that_are_recorded_more_often_in_motion_stay():
    steps = np.tile(np.concatenate([np.full(200, STEP), np.full(30, 100_000_000)]), 12)
    reference = poses(np.cumsum(steps))
    assert evenly_stamped(reference) == (reference, [])
    late = STEP * np.arange(3000) + np.random.default_rng(3).integers(0, 5_000_000, 3000)
    reference = poses(np.sort(late))
    assert evenly_stamped(reference) == (reference, [])


def test_bursts_at_uneven_times_are_named():
    begin = np.cumsum(np.random.default_rng(2).exponential(3e7, 800)).astype(np.int64)
    reference = poses(np.sort((begin[:, None] + 50_000 * np.arange(4)).ravel()))
    reference = replace(reference, stamps_ns=np.unique(reference.stamps_ns))
    with pytest.raises(RecordingError, match=r"poses come in bursts: the usual step of their stamps is 0\.05 ms"):
        evenly_stamped(reference)


def on_a_way(late: np.ndarray, taken: np.ndarray) -> ReferencePoses:
    """Return positions of a body at 8 m/s that turns, with noise of 1 cm, at times taken and stamped later."""
    t = 1e-9 * taken
    p = 40.0 * np.column_stack([np.sin(0.2 * t), np.cos(0.2 * t), 0.0 * t])
    p += 0.01 * np.random.default_rng(2).normal(size=p.shape)
    return replace(poses(np.maximum.accumulate(taken + late) + np.arange(taken.size)), positions=p)


def test_poses_that_arrive_late_by_chance_are_even_again():
    taken = 100_000_000 * np.arange(1500)
    late = np.random.default_rng(3).exponential(20e6, taken.size).astype(np.int64)
    found, (warning,) = evenly_stamped(on_a_way(late, taken))
    assert np.abs(np.diff(found.stamps_ns) - 100_000_000).max() < 20_000
    assert "arrive late by chance" in warning.message
    assert found.lateness == pytest.approx(1e-9 * np.std(late), rel=0.2)


def test_poses_that_are_taken_unevenly_keep_their_stamps():
    jitter = np.random.default_rng(3).exponential(20e6, 1500).astype(np.int64)
    taken = np.sort(100_000_000 * np.arange(1500) + jitter)
    reference = on_a_way(0 * taken, taken)
    assert np.ptp(np.diff(reference.stamps_ns)) > 50_000_000
    found, warnings = evenly_stamped(reference)
    assert not warnings
    assert found is reference


def test_poses_that_show_nothing_keep_their_stamps():
    taken = 100_000_000 * np.arange(1500)
    late = np.random.default_rng(3).exponential(20e6, taken.size).astype(np.int64)
    reference = on_a_way(late, taken)
    still = replace(reference, positions=np.random.default_rng(4).normal(size=reference.positions.shape))
    assert not evenly_stamped(still)[1]

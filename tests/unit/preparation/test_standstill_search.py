"""Rests: found where reference and IMU stand, not where a slow move creeps."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.model.assumed_noise import ReferenceNoise
from kreisel.model.standstill import ImuStillness
from kreisel.preparation.standstill_search import find_standstills, imu_stillness
from kreisel.recording.recording import ImuSamples, ReferencePoses
from kreisel.synchronization.clock import Clock

NOISE = ReferenceNoise(1e-3, 1e-3, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 0.0)
MOVES, MOVE, REST = 6, 8.0, 2.0


def moved(way, scatter=0.0):
    """Return poses that go `way` m in every move, each slow to begin and to end, and rest between."""
    t = np.arange(0.0, MOVES * (MOVE + REST), 0.012)
    x = np.clip((t % (MOVE + REST) - REST) / MOVE, 0.0, 1.0)
    s = way * (t // (MOVE + REST) + x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3))
    p = np.column_stack([s, 0.0 * s, 0.0 * s]) + np.random.default_rng(0).normal(0.0, scatter, (t.size, 3))
    q = np.tile([1.0, 0.0, 0.0, 0.0], (t.size, 1))
    return t, s, ReferencePoses("pose0", np.round(t * 1e9).astype(np.int64), p, q, Path("pose0/data.csv"))


def rests_of(reference, t):
    """Return the rests of a body whose IMU notices none of its moves."""
    return find_standstills(ImuStillness(t[::4], np.ones(t[::4].size, dtype=bool)), reference, Clock(0.0), NOISE)


def test_a_slow_move_is_no_rest():
    t, s, reference = moved(way=0.03)  # 8 mm/s at its fastest
    rests = rests_of(reference, t)
    assert len(rests) == MOVES + 1  # the last move ends at rest
    assert all(rest.stop - rest.start > 0.8 * REST - 0.3 for rest in rests[1:-1])
    for rest in rests:
        inside = (t >= rest.start) & (t <= rest.stop)
        assert np.ptp(s[inside]) < NOISE.standstill_position


def test_scatter_of_the_poses_does_not_end_a_rest():
    t, s, reference = moved(way=0.2, scatter=3e-4)
    rests = rests_of(reference, t)
    rested = sum(rest.stop - rest.start for rest in rests)
    assert rested > 0.6 * MOVES * REST
    for rest in rests:
        assert np.ptp(s[(t >= rest.start) & (t <= rest.stop)]) < 2e-3


@pytest.mark.parametrize(("hertz", "size", "rests"), [(5.0, 0.025, False), (8.0, 0.015, False), (60.0, 0.04, True)])
def test_the_tremor_of_a_hand_is_no_rest_and_vibration_is(hertz, size, rests):
    """A device that is held, or lies on a table that hums; what an arm holds rests in either case."""
    t = 0.005 * np.arange(4000)
    rng = np.random.default_rng(1)
    w, a = rng.normal(0.0, 2e-3, (t.size, 3)), rng.normal(0.0, 0.02, (t.size, 3))
    w[:, 1] += 2**0.5 * size * np.sin(2.0 * np.pi * hertz * t)
    imu = ImuSamples(np.round(1e9 * t).astype(np.int64), w, a, Path("imu0"))
    assert imu_stillness(imu, held=True).still[:50].all() == rests
    assert imu_stillness(imu, held=True).still[:50].any() == rests
    assert imu_stillness(imu).still[:50].all()

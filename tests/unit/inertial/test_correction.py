"""Readings corrected: against the truth of a motion in closed form, and block by block against all at once."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kreisel.inertial.correction import Block, Correction, corrected
from kreisel.inertial.sensor_model import SensorParameters, SizeEffect

from ...oracle.motion import AnalyticMotion, inertial_truth, raw_readings

RNG = np.random.default_rng(5)
SENSORS = SensorParameters(
    K_omega=np.eye(3) + RNG.normal(0.0, 0.02, (3, 3)),
    k_w=RNG.normal(0.0, 0.01, (1, 3)),
    K_a=np.eye(3) + RNG.normal(0.0, 0.02, (3, 3)),
    k_a=RNG.normal(0.0, 0.1, (1, 3)),
    lever_arms=RNG.normal(0.0, 0.1, (3, 3)),
    others={"accel_delay": np.array([1e-3]), "gyro_temperature": np.array([1e-4, 2e-4, -1e-4])},
)


def test_the_truth_of_a_motion_is_found_from_its_readings():
    t = 0.0025 * np.arange(4000)
    omega, alpha, f = inertial_truth(
        AnalyticMotion(np.random.default_rng(3)), t, np.array([0.0, 0.0, -9.81]), np.zeros(3)
    )
    plain = SensorParameters(SENSORS.K_omega, SENSORS.k_w, SENSORS.K_a, SENSORS.k_a, SENSORS.lever_arms)
    found = corrected(Block(t, *raw_readings(omega, alpha, f, {**vars(plain)})), plain, SizeEffect.COMPLETED)
    np.testing.assert_allclose(found.rates, omega, atol=1e-12)
    # what cubics miss of the fastest part, at the longest arm
    missed = np.abs(found.forces - f)[3:-3].max()
    assert missed < 2e-4
    assert np.abs(alpha).max() * np.abs(SENSORS.lever_arms).max() > 100.0 * missed


def _stream(gap_at: list[int], count: int = 400) -> Block:
    jitter = np.random.default_rng(2).uniform(-0.3, 0.3, count)
    t = 0.005 * (np.arange(count) + jitter) + 0.4 * np.isin(np.arange(count), gap_at).cumsum()
    phase = np.outer(t, [3.0, 5.0, 7.0])
    return Block(t, np.sin(phase), 9.0 * np.cos(phase), 20.0 + np.sin(t))


@given(st.lists(st.integers(0, 400), max_size=12), st.lists(st.integers(110, 398), max_size=4))
def test_any_split_of_a_stream_gives_the_same_samples(cuts, gap_at):
    raw = _stream(gap_at)
    want = corrected(raw, SENSORS, SizeEffect.COMPLETED)
    stream = Correction(SENSORS, SizeEffect.COMPLETED)
    edges = [0, *sorted(cuts), len(raw)]
    parts = [stream.push(raw.part(a, b)) for a, b in pairwise(edges)] + [stream.close()]
    for name in ("stamps", "rates", "forces"):
        np.testing.assert_allclose(np.concatenate([getattr(p, name) for p in parts]), getattr(want, name), atol=1e-10)


def test_a_stream_is_late_by_three_samples_only():
    raw, stream = _stream([]), Correction(SENSORS, SizeEffect.COMPLETED)
    returned = 0
    for k in range(len(raw)):
        returned += len(stream.push(raw.part(k, k + 1)))
        assert returned == (0 if k < 100 else k + 1 - 3)


@pytest.mark.parametrize("count", [0, 1, 2, 5, 30])
def test_short_streams_come_out_when_they_end(count):
    raw, stream = _stream([]).part(0, count), Correction(SENSORS, SizeEffect.COMPLETED)
    assert len(stream.push(raw)) == 0
    assert len(stream.close()) == count
    assert len(Correction(SENSORS, SizeEffect.COMPLETED).close()) == 0

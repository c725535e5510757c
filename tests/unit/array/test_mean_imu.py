"""How units are brought to the base unit's readings, and their mean."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.array.mean_imu import BaseRows, MeanImu, align
from kreisel.array.resampled import Resampled, clipped_samples
from kreisel.errors import SynchronizationError
from kreisel.geometry.rotation import exp, matrix
from kreisel.recording.recording import Recording
from kreisel.synchronization.clock import Clock

from ...rigid_array import readings_at, recorded, shaken

RATE, SECONDS = 200.0, 40.0
T = np.arange(round(RATE * SECONDS)) / RATE
TURN = matrix(exp(np.array([0.3, -0.2, 0.5])))


@pytest.fixture(scope="module")
def body():
    return shaken(np.random.default_rng(4), SECONDS)


def unit_at(body, place, axes, noise=1e-3, temperature=None):
    rates, forces = readings_at(*body, np.array(place), axes, np.maximum(T, 1e-3))
    rng = np.random.default_rng(5)
    return Resampled(
        rates + noise * rng.normal(size=rates.shape), forces + noise * rng.normal(size=forces.shape),
        temperature, np.ones(T.size, dtype=bool),
    )  # fmt: skip


def aligned(unit, base, path):
    imu = recorded(T, unit.rates, unit.forces, path)
    return align("imu1", imu, Clock(0.0), unit, BaseRows.of(base, T))


def test_the_distance_of_units_does_not_bend_their_matrices(body, tmp_path):
    """By forces alone entries are 0.28 and offsets 3 m/s^2 off here: centripetal forces are no turn and no scale."""
    base, unit = unit_at(body, (0.0, 0.0, 0.0), np.eye(3)), unit_at(body, (0.1, -0.06, 0.03), TURN)
    found = aligned(unit, base, tmp_path)
    assert np.abs(found.gyro[:, :3] - TURN).max() < 1e-3
    assert np.abs(found.accel[:, :3] - TURN).max() < 3e-3
    assert np.abs(found.accel[:, 3]).max() < 0.15


def test_vibration_does_not_weaken_a_matrix(body, tmp_path):
    base, unit = unit_at(body, (0.0, 0.0, 0.0), np.eye(3)), unit_at(body, (0.05, 0.0, 0.0), TURN)
    shake = 5.0 * np.sin(2.0 * np.pi * 37.0 * T)[:, None] * np.array([1.0, -0.5, 0.3])
    found = aligned(replace(unit, forces=unit.forces + shake), base, tmp_path)
    assert np.abs(found.accel[:, :3] - TURN).max() < 0.02


def test_a_unit_with_an_axis_that_is_dead_is_refused_for_what_it_reads(body, tmp_path):
    base, unit = unit_at(body, (0.0, 0.0, 0.0), np.eye(3)), unit_at(body, (0.05, 0.0, 0.0), TURN)
    dead = unit.rates.copy()
    dead[:, 1:] = 0.0
    assert not clipped_samples(dead).any()
    with pytest.raises(SynchronizationError, match="rates explain"):
        aligned(replace(unit, rates=dead), base, tmp_path)


def test_a_mean_has_a_temperature_where_all_units_have_one(body, tmp_path):
    warm = 25.0 + T / 10.0
    base = unit_at(body, (0.0, 0.0, 0.0), np.eye(3), temperature=warm)
    recording = Recording(tmp_path, recorded(T, base.rates, base.forces, tmp_path), None)
    for temperature in (warm, None):
        mean = MeanImu(T)
        for unit in (base, unit_at(body, (0.05, 0.0, 0.0), TURN, temperature=temperature)):
            mean.add(aligned(unit, base, tmp_path), unit)
        imu = mean.recording(recording).imu
        assert (imu.temperature is None) == (temperature is None)
        np.testing.assert_allclose(imu.rates, base.rates, atol=0.02)

"""Missing samples that were filled in on straight lines."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples
from kreisel.validation.filled_rows import without_filled

COUNT = 20_000


def samples(noise=1e-3):
    rng, t = np.random.default_rng(0), 5e-3 * np.arange(COUNT)
    rates = np.column_stack([np.sin(3.0 * t), np.cos(2.0 * t), np.sin(t)]) + noise * rng.normal(size=(COUNT, 3))
    forces = 9.8 * np.column_stack([np.sin(t), np.cos(t), np.sin(2.0 * t)]) + 10.0 * noise * rng.normal(size=(COUNT, 3))
    return ImuSamples(np.arange(COUNT) * 5_000_000, rates.round(9), forces.round(9), Path("imu0/data.csv"))


def filled(imu, places, length):
    """Return the samples with straight lines of a number of rows, and which those are."""
    rates, forces, mask = imu.rates.copy(), imu.accelerations.copy(), np.zeros(COUNT, dtype=bool)
    for place in places:
        share = (np.arange(1, length + 1) / (length + 1))[:, None]
        for values in (rates, forces):
            before, after = values[place - 1].copy(), values[place + length].copy()
            values[place : place + length] = (before + share * (after - before)).round(9)
        mask[place : place + length] = True
    return replace(imu, rates=rates, accelerations=forces), mask


def test_rows_on_straight_lines_are_left_out():
    imu, mask = filled(samples(), (100, 5000, 5050, 12345), 7)
    found, (warning,) = without_filled(imu)
    np.testing.assert_array_equal(found.stamps_ns, imu.stamps_ns[~mask])
    np.testing.assert_array_equal(found.rates, imu.rates[~mask])
    assert "28 samples in 4 places, the first at line 102, lie on straight lines" in warning.message


@pytest.mark.parametrize("length", [1, 2])
def test_one_or_two_in_a_row_stay(length):
    imu, _ = filled(samples(), (100, 5000), length)
    assert without_filled(imu) == (imu, [])


def test_sensors_without_noise_and_in_coarse_steps_stay():
    exact = samples(noise=0.0)
    coarse = replace(exact, rates=exact.rates.round(1), accelerations=exact.accelerations.round(0))
    for imu in (exact, coarse, samples()):
        assert without_filled(imu) == (imu, [])

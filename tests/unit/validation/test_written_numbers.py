"""Numbers written as whole parts and fractions of their own, which lose signs and zeros."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.recording.recording import ImuSamples
from kreisel.validation.written_numbers import check_written

COUNT = 30_000


def readings(seed=0):
    """Return rates and accelerations (n, 3) of a motion of a few hertz, with noise, in thousandths."""
    rng = np.random.default_rng(seed)
    t = 5e-3 * np.arange(COUNT)[:, None]
    moved = [
        sum(np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 7.0, 3)) for f in rng.uniform(0.1, 2.0, 4)) for _ in range(2)
    ]
    noise = rng.normal(0.0, 2e-3, (2, COUNT, 3))
    return (0.2 + moved[0] + noise[0]).round(3), ([0.0, 3.0, 9.8] + 2.0 * moved[1] + noise[1]).round(3)


def imu(rates, accelerations):
    return ImuSamples(np.arange(len(rates)) * 5_000_000, rates, accelerations, Path("imu0/data.csv"))


def test_numbers_as_they_should_be_pass():
    rates, accelerations = readings()
    check_written(imu(rates, accelerations))
    check_written(imu(np.abs(rates), accelerations))  # never below zero, as one axis of a device that turns one way


@pytest.mark.parametrize("step", [0.25, 1e-3, 0.7])
def test_steps_of_a_converter_pass(step):
    """Also those whose zero is between two steps."""
    rates, accelerations = readings()
    check_written(imu(np.round(rates / step) * step, np.trunc(accelerations / step) * step))
    check_written(imu((np.round(rates / step) + 0.3) * step, accelerations))


@pytest.mark.parametrize("unit", [1.0, np.pi / 180.0])
def test_a_lost_sign_is_named(unit):
    rates, accelerations = readings()
    rates[:, 1] = np.where((rates[:, 1] > -unit) & (rates[:, 1] < 0.0), -rates[:, 1], rates[:, 1])
    with pytest.raises(
        RecordingError, match=r"w_y: no reading lies between -(1|0\.018) and 0, though .*lost their sign"
    ):
        check_written(imu(rates + 1e-9, accelerations))


def test_lost_zeros_behind_the_point_are_named():
    rates, accelerations = readings()
    thousandths = np.abs(np.round(1e3 * accelerations[:, 2])).astype(int)
    words = [f"{value // 1000}.{value % 1000}" for value in thousandths]
    accelerations[:, 2] = np.array(words, dtype=float)
    with pytest.raises(
        RecordingError, match=r"a_z: of \d+ different fractions none begins with a zero: 1\.05 was"
    ) as caught:
        check_written(imu(rates, accelerations))
    assert caught.value.line == 1


def test_a_rest_on_one_side_and_few_readings_on_the_other_pass():
    """Readings at rest just above zero, which motion crosses in a few samples."""
    rates, accelerations = readings()
    rates[:] = 0.005 + 1e-4 * np.random.default_rng(1).normal(size=rates.shape)
    rates[::300] = np.linspace(-3.0, 3.0, len(rates[::300]))[:, None] + 1e-3
    check_written(imu(rates, accelerations))


@pytest.mark.parametrize("size", [1, 30])
def test_rests_in_six_attitudes_pass(size):
    """Of which none is near zero on one side, or has a fraction that begins with a zero; moves last some samples."""
    rng = np.random.default_rng(2)
    faces = 9.81 * np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1], [0, -1, 0], [-1, 0, 0.0]])
    rests = np.repeat(faces, COUNT // 6, axis=0)
    step = np.ones(size) / size
    moved = np.column_stack([np.convolve(column, step, "same") for column in rests.T])
    accelerations = moved + rng.normal([0.35, 0.4, 0.45], 0.01, moved.shape)
    accelerations[np.abs(accelerations) % 1.0 < 0.1] += 0.1
    rates = 0.01 * rng.normal(size=moved.shape)
    check_written(imu(rates, accelerations.round(4)))

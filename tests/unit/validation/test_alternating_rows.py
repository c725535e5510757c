"""Rows of several sensors in one file are refused; what one sensor does at half its sample rate is not."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.recording.recording import ImuSamples
from kreisel.validation.alternating_rows import check_alternating

N = 8000
T = 0.005 * np.arange(N)


def imu(rates, forces=None):
    forces = np.tile([0.1, 0.2, 9.8], (N, 1)) if forces is None else forces
    return ImuSamples((1e9 * T).astype(np.int64), rates, forces, Path("imu0/data.csv"))


def moved(noise=2e-3):
    rng = np.random.default_rng(1)
    return np.sin(np.outer(T, [2.0, 3.0, 5.0])) + noise * rng.normal(size=(N, 3))


@pytest.mark.parametrize(("count", "said"), [(2, "every second row"), (3, "every third row"), (5, "every 5th row")])
@pytest.mark.parametrize("lost", [0, 20])
def test_offsets_of_several_sensors_show_them(count, said, lost):
    rng = np.random.default_rng(2)
    which = np.arange(N + lost) % count
    which = np.delete(which, rng.choice(N, lost, replace=False))
    offsets = 0.02 * np.random.default_rng(3).normal(size=(count, 3))
    with pytest.raises(RecordingError, match=f"{said} differs by .*rows of {count} sensors seem to alternate"):
        check_alternating(imu(moved() + offsets[which]))


def test_one_sensor_that_repeats_hums_or_has_no_noise_is_none_of_several():
    check_alternating(imu(moved(0.0)))
    check_alternating(imu(moved()[np.arange(N) // 2 * 2]))
    beat = 0.05 * np.cos(np.pi * np.arange(N) + 2.0 * np.pi * 0.03 * T)
    check_alternating(imu(moved() + beat[:, None]))
    check_alternating(imu(np.zeros((N, 3))))
    steps = 0.01
    check_alternating(imu(np.round(moved() / steps) * steps))

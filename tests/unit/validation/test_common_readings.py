"""Recordings that overlap share readings; others do not, however coarse these are."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.recording.recording import ImuSamples
from kreisel.validation.common_readings import share_in_common

N = 5000


def imu(values, start=0):
    stamps = start + 5_000_000 * np.arange(len(values))
    return ImuSamples(stamps, values[:, :3], values[:, 3:], Path("imu0/data.csv"))


def readings(seed, step=0.0):
    rng = np.random.default_rng(seed)
    t = 0.005 * np.arange(N)[:, None]
    still = (t % 4.0 < 2.0).astype(float)
    values = np.sin(t * np.arange(1.0, 7.0) + seed) * (1.0 - still) + 1e-3 * rng.normal(size=(N, 6))
    return np.round(values / step) * step if step else values


@pytest.mark.parametrize(("cut", "share"), [(slice(0, N), 1.0), (slice(0, N - 5), 1.0), (slice(1000, 3000), 1.0)])
def test_a_part_is_in_the_whole(cut, share):
    whole = readings(1)
    assert share_in_common(imu(whole), imu(whole[cut], start=10**15)) == share


def test_logs_that_overlap_share_what_both_have():
    whole = readings(1)
    found = share_in_common(imu(whole[:3000]), imu(whole[2000:]))
    assert found == pytest.approx(1.0 / 3.0, abs=0.01)


@pytest.mark.parametrize("step", [0.0, 2e-3, 1e-2])
def test_two_recordings_of_one_motion_share_nothing(step):
    assert share_in_common(imu(readings(1, step)), imu(readings(2, step))) < 1e-3
    assert share_in_common(imu(np.zeros((N, 6))), imu(np.zeros((N, 6)))) == 0.0

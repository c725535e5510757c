"""What is said of stamps that run backwards: displaced rows are to be sorted, readings in their order are not."""

from pathlib import Path

import numpy as np
import pytest

from kreisel.errors import RecordingError
from kreisel.recording.recording import ImuSamples
from kreisel.validation.stamp_checks import check_stamps

N = 4000


def samples(*, packets: bool) -> ImuSamples:
    """Return readings of smooth motion: stamps of packets that overlap, or rows that are displaced."""
    rng = np.random.default_rng(1)
    t = 5e-3 * np.arange(N)
    rates = np.column_stack([np.sin(5.0 * t), np.cos(4.0 * t), np.sin(3.0 * t)]) + 1e-3 * rng.normal(size=(N, 3))
    if packets:  # ten of them; the last sample of a packet has the moment of arrival
        late = np.repeat(rng.exponential(8e-3, N // 10), 10)
        return ImuSamples(np.round(1e9 * (t + late)).astype(np.int64), rates, np.ones((N, 3)), Path("imu0/data.csv"))
    order = np.arange(N)
    for k in rng.choice(N // 40, 60, replace=False) * 40:
        order[k : k + 30] = order[k : k + 30][::-1]
    stamps = np.round(1e9 * t).astype(np.int64)
    return ImuSamples(stamps[order], rates[order], np.ones((N, 3)), Path("imu0/data.csv"))


def test_readings_that_are_in_their_order_are_not_to_be_sorted():
    with pytest.raises(RecordingError, match="so do not sort: stamps of packets overlap"):
        check_stamps(samples(packets=True), "IMU")


def test_displaced_rows_are_to_be_sorted():
    with pytest.raises(RecordingError, match="; sort the rows"):
        check_stamps(samples(packets=False), "IMU")

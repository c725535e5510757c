"""The recording of a freely moving body: its calibration finds the truth, within its deviations and without bias."""

import numpy as np
import pytest

from kreisel.calibration.calibrate import calibrate
from kreisel.calibration.data_sheet import QUANTITIES
from kreisel.simulation.free_motion import TIME_OFFSET, free_recording


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_its_calibration_finds_the_truth(seed):
    truth, recording = free_recording(40.0, np.random.default_rng(seed))
    found = calibrate(recording)
    assert found.accepted
    scores = np.concatenate([
        (found.derived[q.name].value - q.value(truth)) / found.derived[q.name].deviation for q in QUANTITIES
    ])  # fmt: skip
    assert np.sqrt(np.mean(scores**2)) < 1.6
    assert np.abs(scores).max() < 4.5
    first = (recording.imu.stamps_ns[0] - recording.reference.stamps_ns[0]) * 1e-9
    assert first == pytest.approx(TIME_OFFSET, abs=1e-9)
    assert found.timing.offset == pytest.approx(TIME_OFFSET, abs=5.0 * found.timing.offset_sd)

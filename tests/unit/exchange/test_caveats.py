"""What every format with comments says: that a calibration was rejected, and that readings are counts."""

from dataclasses import replace

import numpy as np
import pytest

from kreisel.calibration.result_sections import Verdict
from kreisel.exchange.exported import ExportRequest
from kreisel.exchange.exported_noise import noise_of
from kreisel.exchange.targets import TARGETS
from kreisel.inertial.counts import Counts

from ..calibration.example import calibration

WITHOUT_COMMENTS = {"json", "imu_tk"}


@pytest.mark.parametrize("name", sorted(set(TARGETS) - WITHOUT_COMMENTS))
def test_files_say_what_they_must_not_be_used_for(name):
    own = calibration().in_axes("imu")
    assert own.recording is not None
    counts = Counts(1e-5, 1e-3, np.array([32768.0, 0.0, 0.0]), np.zeros(3))
    rejected = replace(
        own, recording=replace(own.recording, counts=counts), verdict=Verdict(False, ("it does not fit",), ())
    )
    noise = noise_of(own, "fog-mems")
    texts = TARGETS[name].export(ExportRequest(rejected, noise)).files.values()
    for said in ("REJECTED, do not use: it does not fit", "rates (count - [32768, 0, 0]) * 1e-05 rad/s"):
        assert all(said in text for text in texts)
    plain = TARGETS[name].export(ExportRequest(own, noise)).files.values()
    assert not any("REJECTED" in text or "Of counts" in text for text in plain)

"""A timer that is slower is not a stream with lost samples, although both have a clock that runs late."""

from pathlib import Path

import pytest

from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.preparation.prepare import prepare_recording
from kreisel.simulation.cell import simulate
from kreisel.simulation.cell_settings import parse_cell


@pytest.mark.parametrize("kind", ["mocap", "robot"])
@pytest.mark.parametrize("ppm", [-2000.0, pytest.param(-5000.0, marks=pytest.mark.slow)])
def test_a_slower_timer_loses_no_samples(kind, ppm):
    cell = {
        "seed": 5, "run": 1, "seconds": 90.0, "reference": {"kind": kind, "clock_drift_ppm": ppm},
        "imu": {"grade": "industrial-mems"}, "stated": {"joints": False},
    }  # fmt: skip
    recording = simulate(parse_cell(cell, Path("CELL.toml")), Path("slow"))[1]
    prepared = prepare_recording(recording, CalibrationSettings())
    assert not any("lost" in str(warning) for warning in prepared.warnings)
    assert prepared.rate_fit.clock.skew == pytest.approx(1e-6 * ppm, abs=2e-5)

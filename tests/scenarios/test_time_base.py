"""A timer of the IMU with a rate of its own: the gyros' scale must not follow it unnoticed."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import calibrate
from kreisel.recording.recording import Recording
from kreisel.simulation.cell import Truth, simulate
from kreisel.simulation.cell_settings import parse_cell

pytestmark = pytest.mark.slow

RATIO = 3e-3


@cache
def recorded(ratio: float = RATIO) -> tuple[Truth, Recording]:
    """A recording whose IMU counts stamps with an interval that is longer than the true one by a ratio."""
    cell = {"seed": 5, "seconds": 80.0, "reference": {"kind": "mocap"}, "imu": {"grade": "consumer-mems"}}
    truth, made = simulate(parse_cell(cell, Path("CELL.toml")), Path("counted"))
    stamps = made.imu.stamps_ns
    counted = stamps[0] + np.round((stamps - stamps[0]) * (1.0 + ratio)).astype(np.int64)
    return truth, replace(made, imu=replace(made.imu, stamps_ns=counted))


def stated(recording: Recording, base: str) -> Recording:
    imu = recording.settings.imu.model_copy(update={"time_base": base})
    return replace(recording, settings=recording.settings.model_copy(update={"imu": imu}))


def scores(calibration, truth):
    return (np.diag(calibration.sensors.K_omega) / np.diag(truth.sensors.K_omega) - 1.0) / np.diag(
        calibration.sensor_sd.K_omega
    )


@pytest.mark.parametrize("ratio", [RATIO, -RATIO])
def test_stamps_are_put_onto_the_reference_clock_where_that_is_stated(ratio):
    truth, recording = recorded(ratio)
    found = calibrate(stated(recording, "reference"))
    assert found.accepted
    assert np.abs(scores(found, truth)).max() < 4.0
    assert np.diag(found.sensor_sd.K_omega).max() < 2e-4
    assert found.timing.skew == pytest.approx(ratio, abs=5.0 * found.timing.skew_sd if found.timing.skew_sd else 2e-5)
    assert any("put onto the reference's clock" in text for text in found.recording.warnings)
    # as by the true stamps, but in seconds as recorded
    first = recording.imu.stamps_ns[0] - recording.reference.stamps_ns[0]
    start = truth.time_offset - 1e-9 * first
    assert found.timing.offset == pytest.approx((1.0 + ratio) * start + 1e-9 * first, abs=5.0 * found.timing.offset_sd)


@pytest.mark.parametrize("ratio", [RATIO, -RATIO])
def test_the_difference_is_an_uncertainty_where_nothing_is_stated(ratio):
    truth, recording = recorded(ratio)
    found = calibrate(recording)
    assert found.accepted
    assert np.abs(scores(found, truth)).max() < 2.0
    assert np.diag(found.sensor_sd.K_omega).min() > 0.9 * RATIO
    assert any("it is not known which is right" in text for text in found.recording.warnings)
    assert not any("lost" in text for text in found.recording.warnings)


def test_the_clock_of_the_imu_is_right_where_that_is_stated():
    _, recording = recorded()
    found = calibrate(stated(recording, "imu"))
    assert np.diag(found.sensor_sd.K_omega).max() < 2e-4
    assert not any("clocks" in text for text in found.recording.warnings)

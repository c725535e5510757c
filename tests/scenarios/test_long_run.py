"""An hour of data: the factor stays a factor, nothing grows that should not, stretches are joined without a seam."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.calibrate import run_calibration
from kreisel.inertial import readings
from kreisel.model.calibration_settings import CalibrationSettings
from kreisel.recording import recording as module

from ..small_cell import simulate

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("sigma_points", ["central-difference", "unscented"])
def test_an_hour_stays_positive_definite(sigma_points):
    truth, recording = simulate(np.random.default_rng(7), 3600.0, Path("hour"), imu_rate=50.0)
    outcome = run_calibration(recording, CalibrationSettings(sigma_points=sigma_points, passes=1))
    history = outcome.estimate.run.history
    assert history.nis.size > 7000
    assert np.isfinite(history.deviations).all()
    assert (history.deviations > 0.0).all()
    covariance = outcome.estimate.run.belief.covariance
    scale = np.sqrt(np.diag(covariance))
    smallest = float(np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0])
    print(f"{sigma_points}: smallest eigenvalue of the correlation matrix {smallest:.3g}")
    assert smallest > 0.0
    error = outcome.calibration.sensors.k_a[0] - truth.sensors.k_a[0]
    deviation = np.array(outcome.calibration.document["standard_deviation"]["accelerometer"]["offset"])
    assert np.all(np.abs(error) < 5.0 * deviation)


def test_worked_through_in_short_stretches_it_is_the_same(monkeypatch):
    """First values come from other windows then; the filter's estimates must not notice."""
    _, recording = simulate(np.random.default_rng(8), 120.0, Path("run"))
    found = []
    for stretch in (1 << 17, 3000):
        monkeypatch.setattr(readings, "CHUNK", stretch)
        monkeypatch.setattr(module, "CHUNK", stretch)
        fresh = replace(recording, imu=replace(recording.imu), reference=replace(recording.reference))
        found.append(run_calibration(fresh, CalibrationSettings()).estimate.run.belief)
    whole, parts = found
    assert whole.mean.shape == parts.mean.shape
    off = (parts.mean - whole.mean)[:24] / whole.standard_deviation[:24]
    assert np.max(np.abs(off)) < 0.1
    np.testing.assert_allclose(parts.standard_deviation, whole.standard_deviation, rtol=0.02)


def test_a_reference_in_the_middle_of_a_long_recording_is_found(monkeypatch):
    """First values come from where the reference is, not from stretches spread over all."""
    truth, recording = simulate(np.random.default_rng(9), 400.0, Path("run"), imu_rate=200.0)
    monkeypatch.setattr(readings, "CHUNK", 2000)
    monkeypatch.setattr(readings, "EXCERPT", 4)
    t = recording.reference.seconds
    recording = replace(recording, reference=recording.reference.part((t > 210.0) & (t < 280.0)))
    outcome = run_calibration(recording, CalibrationSettings())
    error = outcome.calibration.sensors.k_a[0] - truth.sensors.k_a[0]
    deviation = np.array(outcome.calibration.document["standard_deviation"]["accelerometer"]["offset"])
    assert np.all(np.abs(error) < 5.0 * deviation)
    assert outcome.calibration.document["verdict"]["accepted"]

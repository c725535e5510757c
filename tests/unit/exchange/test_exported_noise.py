"""Which noise figures an export uses, and when it uses none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kreisel.calibration.result_sections import StatedNoise
from kreisel.errors import SettingsError
from kreisel.exchange.exported import ExportRequest
from kreisel.exchange.exported_noise import noise_of
from kreisel.exchange.targets import TARGETS
from kreisel.inertial.noise_figures import noise
from kreisel.recording.recording import ImuSamples

from ..calibration.example import calibration


def resting(seconds: float, moved: float = 0.0) -> ImuSamples:
    rate = 20.0
    n = int(seconds * rate)
    rng = np.random.default_rng(4)
    rates, forces = noise(rng, n, rate, 1e-3, 1e-4, 1e-5), noise(rng, n, rate, 2e-3, 2e-4, 2e-5)
    rates[n // 2 : n // 2 + 40] += moved
    stamps = (np.arange(n) * 1e9 / rate).astype(np.int64)
    return ImuSamples(stamps, rates, np.add(forces, [0.0, 0.0, 9.8]), Path("rest"))


def stated(**figures: float | None):
    own = calibration()
    assert own.recording is not None
    noise = StatedNoise("recording.toml", 1e-4, 1e-3, figures.get("gyro_walk"), figures.get("accel_walk"))
    return replace(own, recording=replace(own.recording, noise=noise))


def test_missing_walks_are_named_and_never_taken_from_the_filter():
    with pytest.raises(
        SettingsError, match=r"states the random walk of the gyros' offsets, random walk of the acc.*--at-rest"
    ):
        TARGETS["kalibr"].export(ExportRequest(stated(), noise_of(stated())))
    with pytest.raises(SettingsError, match="states the gyros' noise density"):
        TARGETS["openvins"].export(ExportRequest(calibration(), noise_of(calibration())))


def test_what_is_stated_then_the_grade_then_the_rest():
    found = noise_of(stated(gyro_walk=1e-6, accel_walk=1e-5))
    assert found.figures["gyro_walk"] == 1e-6
    assert found.sources["gyro_walk"] == "stated: recording.toml"
    found = noise_of(stated(), "fog-mems")
    assert found.sources == dict.fromkeys(found.figures, "grade fog-mems")
    found = noise_of(stated(), "fog-mems", resting(3000.0))
    assert all(source.startswith("Allan deviation of 0.83 h at rest") for source in found.sources.values())
    assert found.figures["gyro_density"] == pytest.approx(1e-3, rel=0.05)
    assert found.figures["accel_density"] == pytest.approx(2e-3, rel=0.05)


def test_what_is_no_rest_is_refused():
    with pytest.raises(SettingsError, match="last 100 s, expected 600 s or more"):
        noise_of(calibration(), at_rest=resting(100.0))
    with pytest.raises(SettingsError, match=r"gyro readings are not at rest: near (499|50\d) s"):
        noise_of(calibration(), at_rest=resting(1000.0, moved=0.5))
    with pytest.raises(SettingsError, match="unknown grade 'best'"):
        noise_of(calibration(), "best")
